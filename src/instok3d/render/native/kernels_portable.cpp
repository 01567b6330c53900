// The kernels for any processor. Only functions without external linkage in here: the linker keeps
// one copy of an inline function that others see, and it may be one that the machine lacks.
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "kernels.hpp"
#include "lanes_portable.hpp"

namespace instok3d {

#include "projection.inl"
#include "images.inl"
#include "features.inl"
#include "tiles.inl"

const Kernels portable_kernels = {"portable", project, draw, draw_backward, project_backward};

}  // namespace instok3d
