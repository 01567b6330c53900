"""The 66 classes of the rooms, which of them are stuff, and their ScanNet20 and NYU40 names."""

STUFF = ("wall", "floor", "ceiling")
"""Classes that are surfaces of the room, not objects; each wall is still its own instance."""

SCANNET20 = {
    "wall": "wall", "floor": "floor", "door": "door", "window": "window", "chair": "chair",
    "armchair": "chair", "sofa": "sofa", "table": "table", "coffee table": "table",
    "side table": "table", "desk": "desk", "counter": "counter", "bookshelf": "bookshelf",
    "cabinet": "cabinet", "wardrobe": "cabinet", "tv stand": "cabinet",
    "refrigerator": "refrigerator", "bed": "bed", "toilet": "toilet", "sink": "sink",
    "bathtub": "bathtub", "shower curtain": "shower curtain", "picture": "picture",
    "curtain": "curtain",
}  # fmt: skip
"""ScanNet20 name of a class; every class that is not here is "otherfurniture"."""

NYU40 = SCANNET20 | {
    "ceiling": "ceiling", "dresser": "dresser", "nightstand": "night stand", "shelf": "shelves",
    "pillow": "pillow", "lamp": "lamp", "ceiling lamp": "lamp", "television": "television",
    "monitor": "television", "rug": "floor mat", "mirror": "mirror",
    "whiteboard": "whiteboard", "box": "box", "backpack": "bag", "suitcase": "otherprop",
    "books": "books", "ball": "otherprop", "vase": "otherprop", "bottle": "otherprop",
    "cup": "otherprop", "bowl": "otherprop", "clock": "otherprop", "laptop": "otherprop",
    "keyboard": "otherprop", "telephone": "otherprop", "plant": "otherprop",
    "trash can": "otherprop", "toaster": "otherprop", "microwave": "otherprop",
    "printer": "otherprop", "paper": "paper", "towel": "towel", "clothes": "clothes",
    "shoes": "otherprop", "bag": "bag",
}  # fmt: skip
"""NYU40 name of a class; every class that is not here is "otherfurniture"."""

CLASSES = (
    "wall", "floor", "ceiling", "door", "window", "chair", "stool", "bench", "sofa", "armchair",
    "ottoman", "table", "coffee table", "side table", "desk", "counter", "bookshelf", "cabinet",
    "dresser", "nightstand", "wardrobe", "tv stand", "shelf", "refrigerator", "washing machine",
    "oven", "microwave", "toaster", "bed", "pillow", "toilet", "sink", "bathtub",
    "shower curtain", "lamp", "ceiling lamp", "monitor", "television", "laptop", "keyboard",
    "printer", "telephone", "plant", "rug", "picture", "mirror", "whiteboard", "clock",
    "radiator", "curtain", "box", "trash can", "backpack", "suitcase", "ball", "vase", "bottle",
    "cup", "bowl", "books", "piano", "paper", "towel", "clothes", "shoes", "bag",
)  # fmt: skip
"""Every class name that an instance can have."""
