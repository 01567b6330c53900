"""Geometry backbones: features, depth and cameras from photos, behind one interface."""
