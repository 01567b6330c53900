"""Many scenes at once: a folder of photos for each."""
