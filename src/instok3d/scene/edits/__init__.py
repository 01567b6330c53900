"""Edits of scenes: operations, their history, and the log that a scene folder keeps of them."""
