"""Kernels of the backbones in C++: what `alignment` does step by step, for small photos at once."""
