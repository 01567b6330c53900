// Dot products of float16 rows and one float32 query: as fast as memory gives the rows.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include "shapes.hpp"
#include "team.hpp"

#if defined(__x86_64__) || defined(_M_X64)
#define INSTOK3D_X86_SEARCH
#include <immintrin.h>
#endif

namespace nb = nanobind;

namespace instok3d {
namespace {

constexpr std::int64_t ROWS_OF_A_TASK = 2048;

using Dot = float (*)(const std::uint16_t* row, const float* query, std::size_t channels);

float to_float(std::uint16_t half) {
  const std::uint32_t sign = std::uint32_t(half & 0x8000u) << 16, magnitude = half & 0x7fffu;
  std::uint32_t bits;
  if (magnitude >= 0x7c00u) {  // infinite, or no number
    bits = sign | 0x7f800000u | (magnitude & 0x3ffu) << 13;
  } else if (magnitude >= 0x400u) {
    bits = sign | ((magnitude << 13) + 0x38000000u);
  } else {  // below the normal numbers: a multiple of 2^-24
    const float value = static_cast<float>(magnitude) * 0x1p-24f;
    std::memcpy(&bits, &value, sizeof bits);
    bits |= sign;
  }
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

float dot_portable(const std::uint16_t* row, const float* query, std::size_t channels) {
  float sum = 0;
  for (std::size_t i = 0; i < channels; ++i) sum += to_float(row[i]) * query[i];
  return sum;
}

#ifdef INSTOK3D_X86_SEARCH
// Four sums at once: one would wait for itself.
__attribute__((target("avx2,fma,f16c"))) float dot_avx2(const std::uint16_t* row,
                                                        const float* query,
                                                        std::size_t channels) {
  __m256 sums[4] = {_mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps(),
                    _mm256_setzero_ps()};
  std::size_t i = 0;
  for (; i + 32 <= channels; i += 32) {
    for (int lane = 0; lane < 4; ++lane) {
      const auto* halves = reinterpret_cast<const __m128i*>(row + i + 8 * lane);
      sums[lane] = _mm256_fmadd_ps(_mm256_cvtph_ps(_mm_loadu_si128(halves)),
                                   _mm256_loadu_ps(query + i + 8 * lane), sums[lane]);
    }
  }
  const __m256 sum =
      _mm256_add_ps(_mm256_add_ps(sums[0], sums[1]), _mm256_add_ps(sums[2], sums[3]));
  float parts[8];
  _mm256_storeu_ps(parts, sum);
  float total = 0;
  for (float part : parts) total += part;
  return total + dot_portable(row + i, query + i, channels - i);
}

__attribute__((target("avx512f"))) float dot_avx512(const std::uint16_t* row, const float* query,
                                                    std::size_t channels) {
  __m512 sums[4] = {_mm512_setzero_ps(), _mm512_setzero_ps(), _mm512_setzero_ps(),
                    _mm512_setzero_ps()};
  std::size_t i = 0;
  for (; i + 64 <= channels; i += 64) {
    for (int lane = 0; lane < 4; ++lane) {
      const auto* halves = reinterpret_cast<const __m256i*>(row + i + 16 * lane);
      sums[lane] = _mm512_fmadd_ps(_mm512_cvtph_ps(_mm256_loadu_si256(halves)),
                                   _mm512_loadu_ps(query + i + 16 * lane), sums[lane]);
    }
  }
  const __m512 sum =
      _mm512_add_ps(_mm512_add_ps(sums[0], sums[1]), _mm512_add_ps(sums[2], sums[3]));
  float parts[16];
  _mm512_storeu_ps(parts, sum);
  float total = 0;
  for (float part : parts) total += part;
  return total + dot_portable(row + i, query + i, channels - i);
}
#endif

// The kernels that this processor has, the fastest first.
struct Kernel {
  const char* name;
  Dot dot;
};

std::vector<Kernel> kernels() {
  std::vector<Kernel> found;
#ifdef INSTOK3D_X86_SEARCH
  if (__builtin_cpu_supports("avx512f")) found.push_back({"avx512", dot_avx512});
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
      __builtin_cpu_supports("f16c")) {
    found.push_back({"avx2", dot_avx2});
  }
#endif
  found.push_back({"portable", dot_portable});
  return found;
}

nb::list kernel_names() {
  nb::list names;
  for (const Kernel& kernel : kernels()) names.append(kernel.name);
  return names;
}

void dot_products(
    const nb::ndarray<const std::uint16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>& rows,
    const nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>& query,
    const nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>& scores, int threads,
    const std::string& name) {
  const std::size_t count = rows.shape(0), channels = rows.shape(1);
  require_shape("query", query, {channels});
  require_shape("scores", scores, {count});
  Dot dot = nullptr;
  for (const Kernel& kernel : kernels()) {
    if (dot == nullptr && (name.empty() || name == kernel.name)) dot = kernel.dot;
  }
  if (dot == nullptr) throw std::invalid_argument("no kernel " + name + " on this processor");
  const std::uint16_t* values = rows.data();
  const float* vector = query.data();
  float* results = scores.data();
  const std::int64_t total = static_cast<std::int64_t>(count);
  const nb::gil_scoped_release release;
  run_stages(usable_threads(threads),
             {{[=] { return (total + ROWS_OF_A_TASK - 1) / ROWS_OF_A_TASK; },
               [=](std::int64_t task, int) {
                 const std::int64_t end = std::min(total, (task + 1) * ROWS_OF_A_TASK);
                 for (std::int64_t row = task * ROWS_OF_A_TASK; row < end; ++row) {
                   results[row] = dot(values + row * channels, vector, channels);
                 }
               }}});
}

}  // namespace
}  // namespace instok3d

NB_MODULE(_search, m) {
  m.def("kernels", &instok3d::kernel_names);
  // Not converted: results would be written to a copy, and the rows are many.
  m.def("dot_products", &instok3d::dot_products, nb::arg("rows").noconvert(), nb::arg("query"),
        nb::arg("scores").noconvert(), nb::kw_only(), nb::arg("threads"), nb::arg("kernel") = "");
}
