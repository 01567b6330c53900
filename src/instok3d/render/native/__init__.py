"""C++ kernels of the rasterizer; the compiled module `_rasterizer` stands here once built."""
