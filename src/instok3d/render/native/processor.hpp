// What the x86 processor at hand can run, asked of it directly: the compilers' own functions for it
// need a library that clang-cl does not link.
#pragma once

namespace instok3d {

bool has_avx2_and_fma();
bool has_avx512();  // the four parts that the kernels use, and FMA

}  // namespace instok3d
