"""The words of the grammar: colours, materials, sizes, places, and what it refuses.

Names of things are not here: whatever is no word of the grammar is embedded.
"""

COLORS = {
    "red": "red", "orange": "orange", "yellow": "yellow", "green": "green", "blue": "blue",
    "turquoise": "turquoise", "purple": "purple", "pink": "pink", "brown": "brown",
    "beige": "beige", "white": "white", "grey": "grey", "black": "black",
    "gray": "grey", "cyan": "turquoise", "teal": "turquoise", "violet": "purple",
    "lilac": "purple", "magenta": "pink", "cream": "beige", "tan": "beige", "crimson": "red",
    "scarlet": "red", "golden": "yellow", "silver": "grey",
}  # fmt: skip
"""Word, and which of the 13 colours that objects have it means."""
SHADES = ("light", "dark", "pale", "bright", "deep")
"""Before a colour; colours are told apart by their 13 names alone."""
MATERIALS = {
    "wood": "wood", "wooden": "wood", "metal": "metal", "metallic": "metal", "steel": "metal",
    "glass": "glass", "leather": "leather", "fabric": "fabric", "plastic": "plastic",
    "ceramic": "ceramic", "porcelain": "ceramic", "rubber": "rubber", "cardboard": "cardboard",
    "paper": "paper",
}  # fmt: skip
"""Word before a thing, and the material that is embedded for it."""

ORDERS = {
    "largest": "largest", "biggest": "largest", "large": "largest", "big": "largest",
    "smallest": "smallest", "littlest": "smallest", "small": "smallest", "little": "smallest",
    "tiny": "smallest", "tiniest": "smallest", "tallest": "tallest", "tall": "tallest",
    "shortest": "shortest", "longest": "longest", "widest": "longest", "highest": "highest",
    "topmost": "highest", "lowest": "lowest",
}  # fmt: skip
"""Word, and the order in which objects are put: by their boxes. "large" is taken for "largest"."""
EXTREMES = {"nearest": "nearest", "closest": "nearest", "farthest": "farthest",
            "furthest": "farthest"}  # fmt: skip

PLACES = {
    ("next", "to"): "next to", ("close", "to"): "next to", ("adjacent", "to"): "next to",
    ("near", "to"): "next to", ("near",): "next to", ("beside",): "next to", ("by",): "next to",
    ("at",): "next to", ("alongside",): "next to",
    ("against",): "against", ("leaning", "on"): "against", ("touching",): "against",
    ("on", "top", "of"): "on", ("on",): "on", ("upon",): "on", ("atop",): "on",
    ("above",): "above", ("over",): "above",
    ("under",): "under", ("underneath",): "under", ("beneath",): "under", ("below",): "under",
    ("inside", "of"): "in", ("inside",): "in", ("within",): "in", ("in",): "in",
    ("between",): "between",
}  # fmt: skip
"""Words that begin a place, and the relation of boxes that they mean."""

GENERIC = ("object", "objects", "thing", "things", "item", "items", "one", "ones", "anything",
           "everything", "something", "stuff", "furniture")  # fmt: skip
"""Nouns that name no kind of thing."""
PURPOSES = ("to", "for", "that", "which", "where", "you", "i", "we", "people", "used", "with")
"""Behind a generic noun: what follows says what the thing is for, and is embedded whole."""

ARTICLES = ("a", "an", "the", "this", "that", "these", "those", "some", "any", "my", "our", "its")
ALL = ("all", "every", "each", "both")
NUMBERS = {word: number for number, word in enumerate(
    ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"), 2)}  # fmt: skip
OPENINGS = (
    ("show", "me"), ("give", "me"), ("tell", "me"), ("look", "for"), ("search", "for"),
    ("where", "is"), ("where", "are"), ("what", "is"), ("what", "are"), ("which", "is"),
    ("which", "are"), ("is", "there"), ("are", "there"), ("i", "want"), ("i", "need"),
    ("there", "is"), ("there", "are"), ("please",), ("find",), ("show",), ("select",),
    ("locate",), ("which",), ("what",),
)  # fmt: skip
"""Taken away from the beginning."""
ENDINGS = (("in", "the", "room"), ("in", "this", "room"), ("in", "here"), ("in", "the", "scene"),
           ("in", "this", "scene"), ("here",), ("please",))  # fmt: skip
"""Taken away from the end: every object is in the room."""
LINKS = ("is", "are", "stands", "standing", "lies", "lying", "hangs", "hanging", "sits", "sitting",
         "placed", "located", "leaning", "mounted", "that", "which", "right", "directly",
         "just")  # fmt: skip
"""Before a place: "the lamp that is standing on the desk"."""
FILLERS = ("colored", "coloured", "made", "is", "are", "which")
"""Between the words of a description: "the chair that is red"."""
ALWAYS_PLURAL = ("books", "clothes", "shoes", "drapes", "glasses", "scissors", "trousers", "jeans",
                 "stairs", "drawers", "blinds", "papers")  # fmt: skip
"""One object may be called by these."""

REFUSED = {
    **dict.fromkeys(
        (
            "not",
            "no",
            "without",
            "except",
            "neither",
            "nor",
            "never",
            "non",
            "isn't",
            "aren't",
            "but",
        ),
        "it cannot be asked for what something is not: leave out {word!r} and choose among the "
        "answers",
    ),
    "or": "one thing at a time: ask for what stands before and behind 'or' apart",
    "and": "one thing at a time: ask for what stands before and behind 'and' apart",
    **dict.fromkeys(
        ("left", "behind", "facing", "opposite"),
        "{word!r} depends on where one looks from: say the place by another thing, such as 'next "
        "to the window'",
    ),
    "than": "sizes are compared by 'largest', 'smallest', 'tallest' or 'longest', not by 'than'",
    "many": "it does not count: ask for all of them, such as 'all chairs', and count the answers",
    **dict.fromkeys(
        ("second", "third", "fourth"),
        "{word!r} is not understood: ask for all, such as 'all tables', and choose among the "
        "answers",
    ),
    **dict.fromkeys(
        ("corner", "middle", "center", "centre"),
        "{word!r} is no place that boxes tell: say the place by another thing, such as 'next to "
        "the window'",
    ),
    **dict.fromkeys(
        ("with", "who", "whose", "when", "why", "how", "if", "does", "do", "was", "were"),
        "{word!r} is not understood: name a thing, with a colour, a material, a size or a place, "
        "such as 'the red chair next to the window'",
    ),
}
"""Words that the grammar knows but does not understand, and what is said then."""
