// The Python module: arrays in and out without copies.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "processor.hpp"
#include "rasterizer.hpp"
#include "shapes.hpp"
#include "team.hpp"

namespace nb = nanobind;

namespace instok3d {
namespace {

template <class T, int AXES>
using Array = nb::ndarray<const T, nb::ndim<AXES>, nb::c_contig, nb::device::cpu>;
template <int AXES>
using Floats = Array<float, AXES>;
template <int AXES>
using MaybeFloats = std::optional<Floats<AXES>>;
using Output = nb::ndarray<nb::pytorch, float, nb::c_contig, nb::device::cpu>;

constexpr std::size_t MAX_CHANNELS = std::size_t(1) << 20;  // times the pixels of a tile is an int

// The fastest first.
std::vector<const Kernels*> usable_kernels() {
  std::vector<const Kernels*> result;
#ifdef INSTOK3D_X86
  if (has_avx512()) result.push_back(&avx512_kernels);
  if (has_avx2_and_fma()) result.push_back(&avx2_kernels);
#endif
  result.push_back(&portable_kernels);
  return result;
}

const Kernels& kernels_named(const std::string& name) {
  static const std::vector<const Kernels*> usable = usable_kernels();
  for (const Kernels* kernels : usable) {
    if (name == "auto" || name == kernels->name) return *kernels;
  }
  throw std::invalid_argument("this processor has no kernels named '" + name + "'");
}

// A tensor in reused memory, which goes back when the tensor is gone.
Output tensor(float*& data, std::initializer_list<std::size_t> shape) {
  std::size_t size = sizeof(float);
  for (const std::size_t length : shape) {
    if (length && size > std::numeric_limits<std::size_t>::max() / length) throw std::bad_alloc();
    size *= length;
  }
  auto buffer = std::make_unique<Buffer>(size);
  data = buffer->as<float>();
  const nb::capsule owner(buffer.get(), [](void* p) noexcept { delete static_cast<Buffer*>(p); });
  buffer.release();
  return Output(data, shape, owner);
}

struct Settings {
  int height, width;
  double near, far, eps2d, alpha_min, alpha_max, transmittance_min;
  float red, green, blue;
};

Inputs inputs(const Floats<3>& means, const Floats<3>& quats, const Floats<3>& scales,
              const Floats<2>& opacities, const Floats<4>& sh,
              const Array<std::int64_t, 2>& anchor_index, const Floats<4>& cam_from_world,
              const Floats<4>& intrinsics, const MaybeFloats<3>& features, const Settings& s) {
  const std::size_t scenes = means.shape(0), gaussians = means.shape(1);
  const std::size_t views = cam_from_world.shape(1), coefficients = sh.shape(2);
  require_shape("means", means, {scenes, gaussians, 3});
  require_shape("quats", quats, {scenes, gaussians, 4});
  require_shape("scales", scales, {scenes, gaussians, 3});
  require_shape("opacities", opacities, {scenes, gaussians});
  require_shape("sh", sh, {scenes, gaussians, coefficients, 3});
  require_shape("anchor_index", anchor_index, {scenes, gaussians});
  require_shape("cam_from_world", cam_from_world, {scenes, views, 4, 4});
  require_shape("intrinsics", intrinsics, {scenes, views, 3, 3});
  if (features) require_shape("features", *features, {scenes, features->shape(1), features->shape(2)});
  if (coefficients != 1 && coefficients != 4 && coefficients != 9 && coefficients != 16) {
    throw std::invalid_argument("sh must have 1, 4, 9 or 16 coefficients");
  }
  if (s.height < 1 || s.width < 1) throw std::invalid_argument("the picture has no pixel");
  require_length("pixels of a picture", std::size_t(s.height) * std::size_t(s.width), MAX_LENGTH);
  Inputs in;
  in.scenes = require_length("scenes", scenes, MAX_LENGTH);
  in.views = require_length("views", views, MAX_LENGTH);
  require_length("pictures", scenes * views, MAX_LENGTH);
  in.gaussians = require_length("Gaussians of a scene", gaussians, MAX_LENGTH);
  in.coefficients = static_cast<int>(coefficients);
  in.anchors = features ? require_length("anchors", features->shape(1), MAX_LENGTH) : 0;
  in.channels = features ? require_length("channels", features->shape(2), MAX_CHANNELS) : 0;
  in.height = require_length("rows of a picture", s.height, MAX_SIDE);
  in.width = require_length("columns of a picture", s.width, MAX_SIDE);
  in.means = means.data();
  in.quats = quats.data();
  in.scales = scales.data();
  in.opacities = opacities.data();
  in.sh = sh.data();
  in.anchor_index = anchor_index.data();
  in.cam_from_world = cam_from_world.data();
  in.intrinsics = intrinsics.data();
  in.features = features ? features->data() : nullptr;
  in.near = s.near;
  in.far = s.far;
  in.eps2d = s.eps2d;
  in.alpha_min = s.alpha_min;
  in.alpha_max = s.alpha_max;
  in.transmittance_min = s.transmittance_min;
  in.background[0] = s.red;
  in.background[1] = s.green;
  in.background[2] = s.blue;
  return in;
}

template <class T>
const float* pointer(const std::optional<T>& array) {
  return array ? array->data() : nullptr;
}

nb::tuple forward(const Floats<3>& means, const Floats<3>& quats, const Floats<3>& scales,
                  const Floats<2>& opacities, const Floats<4>& sh,
                  const Array<std::int64_t, 2>& anchor_index, const Floats<4>& cam_from_world,
                  const Floats<4>& intrinsics, const MaybeFloats<3>& features, const Settings& s,
                  const std::string& instruction_set, int threads) {
  const Inputs in = inputs(means, quats, scales, opacities, sh, anchor_index, cam_from_world,
                           intrinsics, features, s);
  const Kernels& kernels = kernels_named(instruction_set);
  const auto scenes = std::size_t(in.scenes), views = std::size_t(in.views);
  const auto height = std::size_t(in.height), width = std::size_t(in.width);
  Images images = {};
  Output colors = tensor(images.colors, {scenes, views, 3, height, width});
  Output alphas = tensor(images.alphas, {scenes, views, height, width});
  Output depths = tensor(images.depths, {scenes, views, height, width});
  nb::object maps = nb::none();
  if (features) {
    maps = nb::cast(
        tensor(images.features, {scenes, views, std::size_t(in.channels), height, width}));
  }
  std::unique_ptr<Frame> frame;
  {
    const nb::gil_scoped_release release;
    frame = draw_all(in, kernels, images, threads);
  }
  return nb::make_tuple(nb::cast(std::move(frame)), colors, alphas, depths, maps);
}

nb::tuple backward(const Frame& frame, const Floats<3>& means, const Floats<3>& quats,
                   const Floats<3>& scales, const Floats<2>& opacities, const Floats<4>& sh,
                   const Array<std::int64_t, 2>& anchor_index, const Floats<4>& cam_from_world,
                   const Floats<4>& intrinsics, const MaybeFloats<3>& features, const Settings& s,
                   const Floats<5>& colors, const Floats<4>& alphas, const Floats<4>& depths,
                   const MaybeFloats<5>& maps, const MaybeFloats<5>& color_grads,
                   const MaybeFloats<4>& alpha_grads, const MaybeFloats<4>& depth_grads,
                   const MaybeFloats<5>& map_grads, const std::string& instruction_set,
                   int threads) {
  const Inputs in = inputs(means, quats, scales, opacities, sh, anchor_index, cam_from_world,
                           intrinsics, features, s);
  const Kernels& kernels = kernels_named(instruction_set);
  if (!(frame.sizes == in)) {
    throw std::invalid_argument("the frame was drawn from inputs of other sizes");
  }
  const auto require_images = [&](const char* name, const auto& array, std::size_t channels) {
    require_shape(name, array, {std::size_t(in.scenes), std::size_t(in.views), channels,
                                std::size_t(in.height), std::size_t(in.width)});
  };
  const auto require_planes = [&](const char* name, const auto& array) {
    require_shape(name, array, {std::size_t(in.scenes), std::size_t(in.views),
                                std::size_t(in.height), std::size_t(in.width)});
  };
  require_images("colors", colors, 3);
  require_planes("alphas", alphas);
  require_planes("depths", depths);
  if (maps) require_images("maps", *maps, in.channels);
  if (color_grads) require_images("color_grads", *color_grads, 3);
  if (alpha_grads) require_planes("alpha_grads", *alpha_grads);
  if (depth_grads) require_planes("depth_grads", *depth_grads);
  if (map_grads) require_images("map_grads", *map_grads, in.channels);
  if (bool(maps) != bool(features)) {
    throw std::invalid_argument("maps and features belong together");
  }
  const ConstImages images = {colors.data(), alphas.data(), depths.data(), pointer(maps)};
  const ConstImages grads = {pointer(color_grads), pointer(alpha_grads), pointer(depth_grads),
                             pointer(map_grads)};
  const auto scenes = std::size_t(in.scenes), gaussians = std::size_t(in.gaussians);
  Gradients g = {};
  Output to_means = tensor(g.gaussians.means, {scenes, gaussians, 3});
  Output to_quats = tensor(g.gaussians.quats, {scenes, gaussians, 4});
  Output to_scales = tensor(g.gaussians.scales, {scenes, gaussians, 3});
  Output to_opacities = tensor(g.gaussians.opacities, {scenes, gaussians});
  Output to_sh = tensor(g.gaussians.sh, {scenes, gaussians, std::size_t(in.coefficients), 3});
  Output to_cameras = tensor(g.cam_from_world, {scenes, std::size_t(in.views), 4, 4});
  nb::object to_features = nb::none();
  if (map_grads) {
    to_features = nb::cast(
        tensor(g.features, {scenes, std::size_t(in.anchors), std::size_t(in.channels)}));
  }
  {
    const nb::gil_scoped_release release;
    draw_all_backward(in, kernels, frame, images, grads, g, threads);
  }
  return nb::make_tuple(to_means, to_quats, to_scales, to_opacities, to_sh, to_cameras,
                        to_features);
}

}  // namespace
}  // namespace instok3d

NB_MODULE(_rasterizer, m) {
  using namespace instok3d;
  m.doc() = "Native rasterizer of 3D Gaussians; use instok3d.render.render.";
  // A graph that is alive when Python ends, as one in a global or in the traceback of an error, is
  // no leak. That frames go with their graph is tested; these warnings are of this domain alone.
  nb::set_leak_warnings(false);
  nb::class_<Frame>(m, "Frame", nb::is_weak_referenceable(),
                    "What a forward pass leaves for its backward pass.");
  nb::class_<Settings>(m, "Settings", "Size, clipping planes, thresholds and background.")
      .def(nb::init<int, int, double, double, double, double, double, double, float, float,
                    float>(),
           nb::arg("height"), nb::arg("width"), nb::arg("near"), nb::arg("far"), nb::arg("eps2d"),
           nb::arg("alpha_min"), nb::arg("alpha_max"), nb::arg("transmittance_min"),
           nb::arg("red"), nb::arg("green"), nb::arg("blue"));
  m.def("forward", &forward, nb::arg("means"), nb::arg("quats"), nb::arg("scales"),
        nb::arg("opacities"), nb::arg("sh"), nb::arg("anchor_index"), nb::arg("cam_from_world"),
        nb::arg("intrinsics"), nb::arg("features").none(), nb::arg("settings"),
        nb::arg("instruction_set"), nb::arg("threads"));
  m.def("backward", &backward, nb::arg("frame"), nb::arg("means"), nb::arg("quats"),
        nb::arg("scales"), nb::arg("opacities"), nb::arg("sh"), nb::arg("anchor_index"),
        nb::arg("cam_from_world"), nb::arg("intrinsics"), nb::arg("features").none(),
        nb::arg("settings"), nb::arg("colors"), nb::arg("alphas"), nb::arg("depths"),
        nb::arg("maps").none(), nb::arg("color_grads").none(), nb::arg("alpha_grads").none(),
        nb::arg("depth_grads").none(), nb::arg("map_grads").none(), nb::arg("instruction_set"),
        nb::arg("threads"));
  m.def("instruction_sets", [] {
    std::vector<std::string> names;
    for (const Kernels* kernels : usable_kernels()) names.emplace_back(kernels->name);
    return names;
  });
  m.def("threading", [] { return std::string(threading_name()); });
}
