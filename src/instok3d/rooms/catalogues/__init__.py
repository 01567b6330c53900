"""Furniture models and texture files from catalogues, for rooms of more variety."""
