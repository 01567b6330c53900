"""Semantic features of groups and anchors, lifted from 2D features by a frozen tokenizer."""
