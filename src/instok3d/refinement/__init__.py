"""Gaussians optimised on the photos that their scene was made from."""
