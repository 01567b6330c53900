"""Instance ids for footage that has none: masks proposed on keyframes and tracked in between."""
