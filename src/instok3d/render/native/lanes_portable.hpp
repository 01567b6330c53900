// Sixteen float lanes as native vectors of the compiler (GCC and Clang vector extensions): two of
// eight with AVX2, four of four with SSE2 and NEON. Wider vectors than the machine's would be
// taken apart lane by lane.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__AVX2__) || defined(__SSE2__)
#include <immintrin.h>
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#endif

namespace {

#ifdef __AVX2__
constexpr int WIDTH = 8;
constexpr int GEMM_ROWS = 5;
constexpr int GEMM_COLUMNS = 1;
#elif defined(__ARM_NEON)
constexpr int WIDTH = 4;
constexpr int GEMM_ROWS = 5;
constexpr int GEMM_COLUMNS = 1;
#else
constexpr int WIDTH = 4;
constexpr int GEMM_ROWS = 2;
constexpr int GEMM_COLUMNS = 1;
#endif
constexpr int PARTS = 16 / WIDTH;

typedef float Part __attribute__((vector_size(WIDTH * 4)));
typedef std::int32_t MaskPart __attribute__((vector_size(WIDTH * 4)));

struct Lanes {
  Part part[PARTS];
};
struct Mask {
  MaskPart part[PARTS];
};

#define INSTOK3D_EACH _Pragma("GCC unroll 4") for (int i = 0; i < PARTS; ++i)

inline Lanes all(float x) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = Part{} + x;
  return r;
}
inline Lanes load_unaligned(const float* p) {
  Lanes r;
  std::memcpy(&r, p, sizeof r);
  return r;
}
inline void store_unaligned(float* p, const Lanes& v) { std::memcpy(p, &v, sizeof v); }
inline Lanes load(const float* p) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = *reinterpret_cast<const Part*>(p + i * WIDTH);
  return r;
}
inline void store(float* p, const Lanes& v) {
  INSTOK3D_EACH* reinterpret_cast<Part*>(p + i * WIDTH) = v.part[i];
}
inline void stream(float* p, const Lanes& v) { store(p, v); }
inline void finish_streams() {}
inline Lanes load_first(const float* p, int count) {
  Lanes r = all(0.f);
  std::memcpy(&r, p, count * sizeof(float));
  return r;
}
inline void store_first(float* p, const Lanes& v, int count) {
  std::memcpy(p, &v, count * sizeof(float));
}

inline Lanes operator+(const Lanes& a, const Lanes& b) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = a.part[i] + b.part[i];
  return r;
}
inline Lanes operator-(const Lanes& a, const Lanes& b) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = a.part[i] - b.part[i];
  return r;
}
inline Lanes operator*(const Lanes& a, const Lanes& b) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = a.part[i] * b.part[i];
  return r;
}
inline Lanes fma(const Lanes& a, const Lanes& b, const Lanes& c) {  // ab + c
  Lanes r;
  INSTOK3D_EACH r.part[i] = a.part[i] * b.part[i] + c.part[i];
  return r;
}
inline Lanes fnma(const Lanes& a, const Lanes& b, const Lanes& c) {  // c - ab
  Lanes r;
  INSTOK3D_EACH r.part[i] = c.part[i] - a.part[i] * b.part[i];
  return r;
}
inline Lanes smaller(const Lanes& a, const Lanes& b) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = a.part[i] < b.part[i] ? a.part[i] : b.part[i];
  return r;
}
inline Lanes larger(const Lanes& a, const Lanes& b) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = a.part[i] > b.part[i] ? a.part[i] : b.part[i];
  return r;
}
inline Part as_float(MaskPart m) { return reinterpret_cast<Part>(m); }
inline MaskPart as_int(Part m) { return reinterpret_cast<MaskPart>(m); }
inline Lanes absolute(const Lanes& a) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = as_float(as_int(a.part[i]) & 0x7fffffff);
  return r;
}
inline Lanes negative(const Lanes& a) {  // -|a|
  Lanes r;
  INSTOK3D_EACH r.part[i] = as_float(as_int(a.part[i]) | INT32_MIN);
  return r;
}

// About 2e-7 for x <= 0; everything below -126 is taken as -126.
inline Lanes exp2(const Lanes& a) {
  const Lanes x = larger(a, all(-126.f));
  const float round = 12582912.f;  // 1.5 * 2^23: adding it rounds to an integer in the low bits
  Lanes r;
  INSTOK3D_EACH {
    const Part shifted = x.part[i] + round;
    const Part f = x.part[i] - (shifted - round);
    Part p = Part{} + 0.0013276471737935637f;
    p = p * f + 0.009675541539957427f;
    p = p * f + 0.055507132760903515f;
    p = p * f + 0.24022119720076876f;
    p = p * f + 0.6931469670620445f;
    p = p * f + 1.0000000716554311f;
    r.part[i] = as_float(as_int(p) + ((as_int(shifted) - 0x4b400000) << 23));
  }
  return r;
}

inline Lanes reciprocal(const Lanes& a) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = 1.f / a.part[i];
  return r;
}

inline Mask at_least(const Lanes& a, const Lanes& b) {
  Mask r;
  INSTOK3D_EACH r.part[i] = a.part[i] >= b.part[i];
  return r;
}
inline Mask above(const Lanes& a, const Lanes& b) {
  Mask r;
  INSTOK3D_EACH r.part[i] = a.part[i] > b.part[i];
  return r;
}
inline Mask above_within(const Mask& m, const Lanes& a, const Lanes& b) {
  Mask r;
  INSTOK3D_EACH r.part[i] = m.part[i] & (a.part[i] > b.part[i]);
  return r;
}
inline Mask at_most_within(const Mask& m, const Lanes& a, const Lanes& b) {
  Mask r;
  INSTOK3D_EACH r.part[i] = m.part[i] & (a.part[i] <= b.part[i]);
  return r;
}
inline Mask without(const Mask& m, const Mask& other) {
  Mask r;
  INSTOK3D_EACH r.part[i] = m.part[i] & ~other.part[i];
  return r;
}
inline Lanes keep(const Mask& m, const Lanes& a) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = as_float(as_int(a.part[i]) & m.part[i]);
  return r;
}
inline Lanes choose(const Mask& m, const Lanes& a, const Lanes& otherwise) {
  Lanes r;
  INSTOK3D_EACH r.part[i] =
      as_float((as_int(a.part[i]) & m.part[i]) | (as_int(otherwise.part[i]) & ~m.part[i]));
  return r;
}
inline Lanes negative_where(const Mask& m, const Lanes& a) {
  Lanes r;
  INSTOK3D_EACH r.part[i] = as_float(as_int(a.part[i]) | (m.part[i] & INT32_MIN));
  return r;
}
inline std::uint32_t bits(const Mask& m) {
#if defined(__AVX2__)
  return _mm256_movemask_ps(reinterpret_cast<__m256>(m.part[0])) |
         _mm256_movemask_ps(reinterpret_cast<__m256>(m.part[1])) << 8;
#elif defined(__SSE2__)
  std::uint32_t r = 0;
  INSTOK3D_EACH r |= _mm_movemask_ps(reinterpret_cast<__m128>(m.part[i])) << 4 * i;
  return r;
#else
  std::uint32_t r = 0;
  const MaskPart weight = {1, 2, 4, 8};
  INSTOK3D_EACH {
    const MaskPart w = m.part[i] & weight;
    r |= static_cast<std::uint32_t>(w[0] + w[1] + w[2] + w[3]) << 4 * i;
  }
  return r;
#endif
}
inline bool any(const Mask& m) { return bits(m) != 0; }

// Four vectors, each a 4x4 block, <-> four rows of sixteen pixels. Its own inverse.
inline void swap_blocks_and_rows(const Lanes (&in)[4], Lanes (&out)[4]) {
  alignas(64) float from[4][16], to[4][16];
  for (int b = 0; b < 4; ++b) store(from[b], in[b]);
  for (int b = 0; b < 4; ++b) {
    for (int row = 0; row < 4; ++row) std::memcpy(to[row] + 4 * b, from[b] + 4 * row, 16);
  }
  for (int row = 0; row < 4; ++row) out[row] = load(to[row]);
}

inline void transpose(const float* from, std::size_t from_stride, float* to,
                      std::size_t to_stride) {
  for (int i = 0; i < 16; ++i) {
    for (int j = 0; j < 16; ++j) to[i * to_stride + j] = from[j * from_stride + i];
  }
}

// Lane i of the result is the sum of the lanes of v[i]; lanes 10 to 15 are 0.
inline Lanes sums(const Lanes (&v)[10]) {
  alignas(64) float r[16] = {};
  for (int k = 0; k < 10; ++k) {
    Part s = v[k].part[0];
    for (int i = 1; i < PARTS; ++i) s += v[k].part[i];
    float x = 0;
    for (int i = 0; i < WIDTH; ++i) x += s[i];
    r[k] = x;
  }
  return load(r);
}

#undef INSTOK3D_EACH

}  // namespace
