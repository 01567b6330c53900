"""The small backbone of the default model and its solver for the cameras of all views."""
