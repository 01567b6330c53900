// The Python module: arrays in and out without copies.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "alignment.hpp"
#include "shapes.hpp"

namespace nb = nanobind;

namespace instok3d {
namespace {

template <int AXES>
using Floats = nb::ndarray<const float, nb::ndim<AXES>, nb::c_contig, nb::device::cpu>;
template <int AXES>
using Results = nb::ndarray<float, nb::ndim<AXES>, nb::c_contig, nb::device::cpu>;

void align_arrays(const Floats<4>& own_photos, const Floats<4>& photos, const Floats<2>& centers,
                  const Floats<2>& depths, const Floats<3>& peaks, const Floats<3>& warps,
                  const Floats<2>& shifts, const Floats<2>& window, const Results<3>& pixels,
                  const Results<4>& precision, float nearest, float largest_warp,
                  float start_reach, float peak_reach, float nearest_error, float color_noise,
                  float shared, int iterations, int threads) {
  const std::size_t scenes = photos.shape(0), cells = centers.shape(0);
  require_shape("photos", photos, {scenes, 3, photos.shape(2), photos.shape(3)});
  require_shape("own_photos", own_photos, {scenes, 3, own_photos.shape(2), own_photos.shape(3)});
  require_shape("centers", centers, {cells, 2});
  require_shape("depths", depths, {scenes, cells});
  require_shape("peaks", peaks, {scenes, cells, 2});
  require_shape("warps", warps, {scenes, 3, 3});
  require_shape("shifts", shifts, {scenes, 3});
  require_shape("window", window, {PATCH, PATCH});
  require_shape("pixels", pixels, {scenes, cells, 2});
  require_shape("precision", precision, {scenes, cells, 2, 2});
  if (photos.size() == 0 || own_photos.size() == 0) {
    if (scenes * cells == 0) return;
    throw std::invalid_argument("a photo has no pixel");
  }
  AlignmentInputs in;
  in.scenes = require_length("scenes", scenes, MAX_LENGTH);
  in.cells = require_length("cells", cells, MAX_LENGTH);
  in.height = require_length("rows of photos", photos.shape(2), MAX_SIDE);
  in.width = require_length("columns of photos", photos.shape(3), MAX_SIDE);
  in.own_height = require_length("rows of own_photos", own_photos.shape(2), MAX_SIDE);
  in.own_width = require_length("columns of own_photos", own_photos.shape(3), MAX_SIDE);
  in.own_photos = own_photos.data();
  in.photos = photos.data();
  in.centers = centers.data();
  in.depths = depths.data();
  in.peaks = peaks.data();
  in.warps = warps.data();
  in.shifts = shifts.data();
  in.window = window.data();
  in.nearest = nearest;
  in.largest_warp = largest_warp;
  in.start_reach = start_reach;
  in.peak_reach = peak_reach;
  in.nearest_error = nearest_error;
  in.color_noise = color_noise;
  in.shared = shared;
  in.iterations = iterations;
  const nb::gil_scoped_release release;
  align(in, {pixels.data(), precision.data()}, threads);
}

}  // namespace
}  // namespace instok3d

NB_MODULE(_alignment, m) {
  m.def("align", &instok3d::align_arrays, nb::arg("own_photos"), nb::arg("photos"),
        nb::arg("centers"), nb::arg("depths"), nb::arg("peaks"), nb::arg("warps"),
        nb::arg("shifts"), nb::arg("window"),
        // Not converted: results would be written to a copy.
        nb::arg("pixels").noconvert(), nb::arg("precision").noconvert(),
        nb::kw_only(), nb::arg("nearest"), nb::arg("largest_warp"), nb::arg("start_reach"),
        nb::arg("peak_reach"), nb::arg("nearest_error"), nb::arg("color_noise"),
        nb::arg("shared"), nb::arg("iterations"), nb::arg("threads"));
}
