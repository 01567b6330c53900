"""Which generator a furniture model stands in for, by the model's name or, before that, its file.

The names are those of Sweet Home 3D's catalogue in English. What has no class of ours, what belongs
outdoors or into a wall, and what was made to be looked at alone is not here.
"""

CLASS_OF_GENERATOR = {
    "floor_lamp": "lamp", "table_lamp": "lamp", "small_plant": "plant", "coffee_table":
    "coffee table", "side_table": "side table", "tv_stand": "tv stand", "washing_machine":
    "washing machine", "trash_can": "trash can", "shower_curtain": "shower curtain",
    "basket": "box", "cloth": "clothes", "folded_towels": "towel", "hung_clothes": "clothes",
    "hung_towel": "towel", "jar": "bottle", "package": "box", "papers": "paper", "pen_holder":
    "cup", "picture_stand": "picture", "plates": "bowl", "wall_cabinet": "cabinet",
}  # fmt: skip
"""Class of the generators that are not called like it."""

_NAMES = {
    "chair": ("chair", "child chair", "children chair", "office chair", "osaka chair",
              "plastic chair"),
    "armchair": ("armchair", "armchair ottoman", "modern armchair", "winchester armchair"),
    "stool": ("stool", "bar stool", "bar chair"),
    "bench": ("bench", "piano bench"),
    "ottoman": ("puff", "ottoman", "pouf"),
    "sofa": ("sofa", "sofa 2 seats", "sofa 3 seats", "couch", "corner sofa", "burlap sofa",
             "clear sofa", "convertible sofa bz", "futon couch", "winchester sofa"),
    "bed": ("bed", "captain's bed", "child bed", "crib", "day bed", "hospital bed", "iron bed",
            "mezzanine bed"),
    "table": ("table", "bar table", "black table", "folding table", "glass table", "oak table",
              "round table", "table on trestles", "table with tablecloth", "wooden table",
              "wooden alder table", "wooden teak table"),
    "coffee_table": ("coffee table",),
    "side_table": ("side table", "children table"),
    "desk": ("desk", "desk table", "technical table", "wooden desk"),
    "counter": ("drawers cabinet", "island", "lower cabinet", "small lower cabinet"),
    "bookshelf": ("bookcase", "full bookcase", "shelves", "vertical shelves"),
    "cabinet": ("cabinet", "cupboard", "filing cabinet"),
    "dresser": ("changing table", "chest", "dresser with drawers"),
    "nightstand": ("bedside table",),
    "wardrobe": ("wardrobe",),
    "tv_stand": ("tv stand",),
    "piano": ("grand piano", "upright piano"),
    "refrigerator": ("fridge", "large fridge"),
    "washing_machine": ("clothes washing machine", "dryer machine", "washing machine"),
    "oven": ("propane stove",),
    "toaster": ("toaster",),
    "sink": ("small lavatory", "washbasin"),
    "shower_curtain": ("shower curtain",),
    "radiator": ("radiator",),
    "rug": ("bathmat", "doormat", "oriental rug", "round carpet"),
    "floor_lamp": ("floor lamp",),
    "table_lamp": ("camping lamp", "desk lamp", "japanese lantern", "lamp", "little lamp",
                   "pedestal vase lamp"),
    "television": ("tv 16:9", "wall flat tv"),
    "monitor": ("apple imac 1998", "apple imac 2004"),
    "printer": ("inkjet printer and scanner",),
    "telephone": ("phone", "wireless phone"),
    "plant": ("plant",),
    "small_plant": ("bonsai tree", "little plant"),
    "box": ("box", "cardboard box", "crate", "open cardboard box"),
    "suitcase": ("suitcase",),
    "trash_can": ("bullet trash can", "dustbin"),
    "ball": ("basketball", "soccer ball"),
    "vase": ("old jar", "pottery", "vase"),
    "bottle": ("baby bottle", "bottle", "flacon", "medicine bottle", "oil servers", "soap",
               "wine bottle"),
    "jar": ("cosmetics pot", "salt shaker", "sugar"),
    "cup": ("beer glass", "cocktail glass", "coffee cup", "coffee mug", "glass", "plastic cup"),
    "bowl": ("bowl", "bowl with salad"),
    "plates": ("oval plate", "plate"),
    "pen_holder": ("utensils pot",),
    "package": ("medicine box", "milk"),
    "papers": ("newspaper",),
    "basket": ("bread box", "clothes basket", "shopping basket"),
    "picture_stand": ("frame chambord", "frame hôi an"),
    "shoes": ("bootie", "mocassin", "slippers", "sneakers", "woman shoes"),
    "cloth": ("cap", "folded clothes", "hat", "jacket", "short", "skirt", "trousers"),
    "hung_clothes": ("hanging clothes", "suit"),
    "hung_towel": ("towel rack",),
    "wall_cabinet": ("glass door cabinet", "small upper cabinet", "upper cabinet"),
}  # fmt: skip
"""Generator, and the names of models that look like what it makes."""

ON_WALLS = ("hung_clothes", "hung_towel", "wall_cabinet")
"""Generators of things that hang on a wall by their back."""

GENERATOR_OF_NAME = {name: generator for generator, names in _NAMES.items() for name in names}

GENERATOR_OF_FILE = {
    "Blend_Swap_CC-0_armchair": "chair",
    "Blend_Swap_CC-0_bookcase": "cabinet",
    "Blend_Swap_CC-0_towel2": "hung_towel",
    "Scopia_com_bath3_toalla": "folded_towels",
    "Kator_Legaz_towel-rack": "",
    "Scopia_box_room": "",
    "Scopia_dining_room": "cabinet",
    "Scopia_living_lamp": "floor_lamp",
    "Scopia_living_room_table": "coffee_table",
    "Scopia_office_box": "cabinet",
    "Scopia_office_furniture1": "cabinet",
}
"""Files of Sweet Home 3D's libraries whose name says something else than what they show."""


def generator_of(stem: str, name: str) -> str:
    """The generator that a model stands in for; "" for none."""
    by_name = GENERATOR_OF_NAME.get(name.strip().lower(), "")
    return GENERATOR_OF_FILE.get(stem, by_name)


def class_of(generator: str) -> str:
    """The class of what a generator makes."""
    return CLASS_OF_GENERATOR.get(generator, generator)
