"""The C++ kernel of exact search."""
