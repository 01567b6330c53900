// Sixteen float lanes on AVX-512 (F, DQ, BW, VL).
#pragma once

#include <immintrin.h>

#include <cstdint>

namespace {

using Lanes = __m512;
using Mask = __mmask16;

constexpr int GEMM_ROWS = 5;     // register blocks of the small matrix products
constexpr int GEMM_COLUMNS = 4;

inline Lanes all(float x) { return _mm512_set1_ps(x); }
inline Lanes load(const float* p) { return _mm512_load_ps(p); }
inline void store(float* p, Lanes v) { _mm512_store_ps(p, v); }
inline Lanes load_unaligned(const float* p) { return _mm512_loadu_ps(p); }
inline void store_unaligned(float* p, Lanes v) { _mm512_storeu_ps(p, v); }
inline void stream(float* p, Lanes v) { _mm512_stream_ps(p, v); }  // p is 64-byte aligned
inline void finish_streams() { _mm_sfence(); }
inline Mask first(int count) { return static_cast<Mask>((1u << count) - 1); }
inline Lanes load_first(const float* p, int n) { return _mm512_maskz_loadu_ps(first(n), p); }
inline void store_first(float* p, Lanes v, int n) { _mm512_mask_storeu_ps(p, first(n), v); }

inline Lanes fma(Lanes a, Lanes b, Lanes c) { return _mm512_fmadd_ps(a, b, c); }    // ab + c
inline Lanes fnma(Lanes a, Lanes b, Lanes c) { return _mm512_fnmadd_ps(a, b, c); }  // c - ab
inline Lanes smaller(Lanes a, Lanes b) { return _mm512_min_ps(a, b); }
inline Lanes larger(Lanes a, Lanes b) { return _mm512_max_ps(a, b); }
inline Lanes absolute(Lanes a) { return _mm512_abs_ps(a); }
inline Lanes negative(Lanes a) { return _mm512_or_ps(a, all(-0.f)); }  // -|a|

// About 1e-7; exact powers of two stay exact enough. Lanes with x = -inf give NaN.
inline Lanes exp2(Lanes x) {
  const Lanes f = _mm512_reduce_ps(x, 0x09);  // x - floor(x)
  Lanes p = all(0.001877576639192928f);
  p = fma(p, f, all(0.008989340471116922f));
  p = fma(p, f, all(0.05582631741870459f));
  p = fma(p, f, all(0.2401536174171085f));
  p = fma(p, f, all(0.693153073120476f));
  p = fma(p, f, all(0.9999999250679052f));
  return _mm512_scalef_ps(p, x);  // p 2^floor(x)
}

inline Lanes reciprocal(Lanes x) {  // one Newton step on 14 bits
  const Lanes y = _mm512_rcp14_ps(x);
  return _mm512_mul_ps(y, fnma(x, y, all(2.f)));
}

inline Mask at_least(Lanes a, Lanes b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
inline Mask above(Lanes a, Lanes b) { return _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ); }
inline Mask above_within(Mask m, Lanes a, Lanes b) {
  return _mm512_mask_cmp_ps_mask(m, a, b, _CMP_GT_OQ);
}
inline Mask at_most_within(Mask m, Lanes a, Lanes b) {
  return _mm512_mask_cmp_ps_mask(m, a, b, _CMP_LE_OQ);
}
inline Mask without(Mask m, Mask other) { return _kandn_mask16(other, m); }
inline Lanes keep(Mask m, Lanes a) { return _mm512_maskz_mov_ps(m, a); }
inline Lanes choose(Mask m, Lanes a, Lanes otherwise) {
  return _mm512_mask_mov_ps(otherwise, m, a);
}
inline Lanes negative_where(Mask m, Lanes a) { return _mm512_mask_or_ps(a, m, a, all(-0.f)); }
inline std::uint32_t bits(Mask m) { return m; }
inline bool any(Mask m) { return m != 0; }

// Four vectors, each a 4x4 block, <-> four rows of sixteen pixels. Its own inverse.
inline void swap_blocks_and_rows(const Lanes (&in)[4], Lanes (&out)[4]) {
  const Lanes t0 = _mm512_shuffle_f32x4(in[0], in[1], 0x44);
  const Lanes t1 = _mm512_shuffle_f32x4(in[2], in[3], 0x44);
  const Lanes t2 = _mm512_shuffle_f32x4(in[0], in[1], 0xee);
  const Lanes t3 = _mm512_shuffle_f32x4(in[2], in[3], 0xee);
  out[0] = _mm512_shuffle_f32x4(t0, t1, 0x88);
  out[1] = _mm512_shuffle_f32x4(t0, t1, 0xdd);
  out[2] = _mm512_shuffle_f32x4(t2, t3, 0x88);
  out[3] = _mm512_shuffle_f32x4(t2, t3, 0xdd);
}

inline Lanes low_pairs(Lanes a, Lanes b) {
  return _mm512_castpd_ps(_mm512_unpacklo_pd(_mm512_castps_pd(a), _mm512_castps_pd(b)));
}
inline Lanes high_pairs(Lanes a, Lanes b) {
  return _mm512_castpd_ps(_mm512_unpackhi_pd(_mm512_castps_pd(a), _mm512_castps_pd(b)));
}

inline void transpose(const float* from, std::size_t from_stride, float* to,
                      std::size_t to_stride) {
  Lanes r[16], t[16];
  for (int i = 0; i < 16; ++i) r[i] = load(from + i * from_stride);
  for (int i = 0; i < 16; i += 2) {
    t[i] = _mm512_unpacklo_ps(r[i], r[i + 1]);
    t[i + 1] = _mm512_unpackhi_ps(r[i], r[i + 1]);
  }
  for (int i = 0; i < 16; i += 4) {
    r[i] = low_pairs(t[i], t[i + 2]);
    r[i + 1] = high_pairs(t[i], t[i + 2]);
    r[i + 2] = low_pairs(t[i + 1], t[i + 3]);
    r[i + 3] = high_pairs(t[i + 1], t[i + 3]);
  }
  for (int i = 0; i < 4; ++i) {
    t[i] = _mm512_shuffle_f32x4(r[i], r[i + 4], 0x88);
    t[i + 4] = _mm512_shuffle_f32x4(r[i], r[i + 4], 0xdd);
    t[i + 8] = _mm512_shuffle_f32x4(r[i + 8], r[i + 12], 0x88);
    t[i + 12] = _mm512_shuffle_f32x4(r[i + 8], r[i + 12], 0xdd);
  }
  for (int i = 0; i < 4; ++i) {
    store(to + i * to_stride, _mm512_shuffle_f32x4(t[i], t[i + 8], 0x88));
    store(to + (i + 8) * to_stride, _mm512_shuffle_f32x4(t[i], t[i + 8], 0xdd));
    store(to + (i + 4) * to_stride, _mm512_shuffle_f32x4(t[i + 4], t[i + 12], 0x88));
    store(to + (i + 12) * to_stride, _mm512_shuffle_f32x4(t[i + 4], t[i + 12], 0xdd));
  }
}

inline Lanes add_halves(Lanes a, Lanes b) {
  return _mm512_shuffle_f32x4(a, b, 0x88) + _mm512_shuffle_f32x4(a, b, 0xdd);
}

// Lane i of the result is the sum of the lanes of v[i]; lanes 10 to 15 are 0.
inline Lanes sums(const Lanes (&v)[10]) {
  const Lanes zero = _mm512_setzero_ps();
  Lanes pairs[6];
  for (int i = 0; i < 5; ++i) {
    pairs[i] = _mm512_unpacklo_ps(v[2 * i], v[2 * i + 1]) +
               _mm512_unpackhi_ps(v[2 * i], v[2 * i + 1]);
  }
  pairs[5] = zero;
  Lanes fours[3];
  for (int i = 0; i < 3; ++i) {
    fours[i] = low_pairs(pairs[2 * i], pairs[2 * i + 1]) +
               high_pairs(pairs[2 * i], pairs[2 * i + 1]);
  }
  return add_halves(add_halves(fours[0], fours[1]), add_halves(fours[2], zero));
}

}  // namespace
