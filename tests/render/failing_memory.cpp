// Each allocation of a forward and backward pass fails once, in turn: it must be thrown, or done
// without, and must not end the process.
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <new>
#include <vector>

#include "rasterizer.hpp"

std::atomic<long> left{-1};  // allocations until one fails; negative: none does

bool fails() {
  long before = left;
  while (before >= 0 && !left.compare_exchange_weak(before, before - 1)) {
  }
  return before == 0;
}

void* operator new(std::size_t bytes) {
  void* data = fails() ? nullptr : std::malloc(bytes ? bytes : 1);
  if (!data) throw std::bad_alloc();
  return data;
}
void operator delete(void* data) noexcept { std::free(data); }
void operator delete(void* data, std::size_t) noexcept { std::free(data); }

extern "C" void* aligned_alloc(std::size_t alignment, std::size_t bytes) {
  void* data = nullptr;
  if (fails() || posix_memalign(&data, alignment, bytes)) return nullptr;
  return data;
}

using namespace instok3d;

int main() {
  constexpr int COUNT = 1100, ANCHORS = 3, CHANNELS = 2, SIDE = 20, VIEWS = 2;
  std::vector<float> means, quats, scales, opacities(COUNT, 0.5f), sh(3 * COUNT, 0.1f);
  std::vector<std::int64_t> anchors;
  for (int g = 0; g < COUNT; ++g) {
    for (float v : {0.01f * (g % 20 - 10), 0.01f * (g % 13 - 6), 3.f}) means.push_back(v);
    for (float v : {1.f, 0.f, 0.f, 0.f}) quats.push_back(v);
    for (int k = 0; k < 3; ++k) scales.push_back(0.1f);
    anchors.push_back(g % ANCHORS);
  }
  std::vector<float> cameras, intrinsics, features(ANCHORS * CHANNELS, 1.f);
  for (int v = 0; v < VIEWS; ++v) {
    for (float x : {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}) cameras.push_back(x);
    for (float x : {20, 0, 10, 0, 20, 10, 0, 0, 1}) intrinsics.push_back(x);
  }
  Inputs in = {};
  in.scenes = 1, in.views = VIEWS, in.gaussians = COUNT, in.coefficients = 1;
  in.anchors = ANCHORS, in.channels = CHANNELS, in.height = in.width = SIDE;
  in.means = means.data(), in.quats = quats.data(), in.scales = scales.data();
  in.opacities = opacities.data(), in.sh = sh.data(), in.anchor_index = anchors.data();
  in.cam_from_world = cameras.data(), in.intrinsics = intrinsics.data();
  in.features = features.data();
  in.near = 0.05, in.far = 100, in.eps2d = 0.3, in.alpha_min = 1 / 255., in.alpha_max = 0.99;
  in.transmittance_min = 1e-4;
  const std::size_t plane = VIEWS * SIDE * SIDE;
  std::vector<float> colors(3 * plane), alphas(plane), depths(plane), maps(CHANNELS * plane);
  std::vector<float> ones(3 * plane, 1.f), to_means(3 * COUNT), to_quats(4 * COUNT);
  std::vector<float> to_scales(3 * COUNT), to_opacities(COUNT), to_sh(3 * COUNT);
  std::vector<float> to_features(ANCHORS * CHANNELS), to_cameras(16 * VIEWS);
  const Images images = {colors.data(), alphas.data(), depths.data(), maps.data()};
  const ConstImages drawn = {colors.data(), alphas.data(), depths.data(), maps.data()};
  const ConstImages grads = {ones.data(), ones.data(), ones.data(), ones.data()};
  const Gradients out = {{to_means.data(), to_quats.data(), to_scales.data(), to_opacities.data(),
                          to_sh.data()}, to_features.data(), to_cameras.data()};
  const auto pass = [&](int threads) {
    const auto frame = draw_all(in, portable_kernels, images, threads);
    draw_all_backward(in, portable_kernels, *frame, drawn, grads, out, threads);
  };
  for (int threads : {1, 3}) {
    long thrown = 0, failing = 0;
    for (bool done = false; !done; ++failing) {
      left = failing;
      try {
        pass(threads);
        done = left >= 0;  // that many allocations are not made: all have failed once
      } catch (const std::bad_alloc&) {
        ++thrown;
      }
      left = -1;
    }
    std::printf("%d threads, %s\n", threads, thrown > 20 ? "more than 20 thrown" : "too few");
  }
  pass(2);
  std::puts(alphas[SIDE * SIDE / 2 + SIDE / 2] > 0 ? "and drawn" : "and nothing drawn");
}
