#include "processor.hpp"

#ifdef INSTOK3D_X86
#include <cpuid.h>
#include <immintrin.h>

#include <cstdint>

namespace instok3d {
namespace {

struct Features {
  std::uint32_t basic = 0;     // leaf 1, ecx
  std::uint32_t extended = 0;  // leaf 7, ebx
  std::uint64_t saved = 0;     // registers that the system saves when it switches threads
};

__attribute__((target("xsave"))) std::uint64_t saved_registers() { return _xgetbv(0); }

Features features() {
  Features f;
  unsigned a, b, c, d;
  if (__get_cpuid(1, &a, &b, &c, &d)) f.basic = c;
  if (__get_cpuid_count(7, 0, &a, &b, &c, &d)) f.extended = b;
  constexpr std::uint32_t XGETBV = 1u << 27;
  if (f.basic & XGETBV) f.saved = saved_registers();
  return f;
}

bool has(std::uint64_t bits, std::uint64_t wanted) { return (bits & wanted) == wanted; }

constexpr std::uint32_t FMA_AND_AVX = 1u << 12 | 1u << 28;
constexpr std::uint32_t AVX2 = 1u << 5;
constexpr std::uint32_t AVX512_F_DQ_BW_VL = 1u << 16 | 1u << 17 | 1u << 30 | 1u << 31;
constexpr std::uint64_t YMM = 0x06, ZMM = 0xe6;

}  // namespace

bool has_avx2_and_fma() {
  const Features f = features();
  return has(f.basic, FMA_AND_AVX) && has(f.extended, AVX2) && has(f.saved, YMM);
}

bool has_avx512() {
  const Features f = features();
  return has(f.basic, FMA_AND_AVX) && has(f.extended, AVX512_F_DQ_BW_VL) && has(f.saved, ZMM);
}

}  // namespace instok3d
#endif
