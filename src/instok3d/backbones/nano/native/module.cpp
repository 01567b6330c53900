// The Python module: arrays in and out without copies.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdexcept>
#include <string>

#include "alignment.hpp"
#include "bundle.hpp"
#include "shapes.hpp"

namespace nb = nanobind;

namespace instok3d {
namespace {

template <int AXES>
using Floats = nb::ndarray<const float, nb::ndim<AXES>, nb::c_contig, nb::device::cpu>;
template <int AXES>
using Indices = nb::ndarray<const std::int64_t, nb::ndim<AXES>, nb::c_contig, nb::device::cpu>;
template <int AXES>
using Results = nb::ndarray<float, nb::ndim<AXES>, nb::c_contig, nb::device::cpu>;

constexpr std::size_t MAX_NODES = std::size_t(1) << 12;  // their square is an int

void align_arrays(const Floats<4>& own_photos, const Floats<4>& photos, const Floats<2>& centers,
                  const Floats<2>& depths, const Floats<3>& peaks,
                  const Floats<2>& confidence, const Floats<3>& warps, const Floats<2>& shifts, const Floats<2>& window, const Results<3>& pixels,
                  const Results<4>& precision, float nearest, float largest_warp,
                  float start_reach, float peak_reach, float nearest_error, float color_noise,
                  float shared, float least_confidence, int iterations, int threads) {
  const std::size_t scenes = photos.shape(0), cells = centers.shape(0);
  require_shape("photos", photos, {scenes, 3, photos.shape(2), photos.shape(3)});
  require_shape("own_photos", own_photos, {scenes, 3, own_photos.shape(2), own_photos.shape(3)});
  require_shape("centers", centers, {cells, 2});
  require_shape("depths", depths, {scenes, cells});
  require_shape("peaks", peaks, {scenes, cells, 2});
  require_shape("confidence", confidence, {scenes, cells});
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
  require_length("pixels of photos", photos.shape(2) * photos.shape(3), MAX_LENGTH);
  in.own_height = require_length("rows of own_photos", own_photos.shape(2), MAX_SIDE);
  in.own_width = require_length("columns of own_photos", own_photos.shape(3), MAX_SIDE);
  in.own_photos = own_photos.data();
  in.photos = photos.data();
  in.centers = centers.data();
  in.depths = depths.data();
  in.peaks = peaks.data();
  in.confidence = confidence.data();
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
  in.least_confidence = least_confidence;
  in.iterations = iterations;
  const nb::gil_scoped_release release;
  align(in, {pixels.data(), precision.data()}, threads);
}

void require_indices(const char* name, const Indices<1>& values, std::size_t length) {
  for (std::size_t i = 0; i < values.shape(0); ++i) {
    if (values(i) < 0 || std::size_t(values(i)) >= length) {
      throw std::invalid_argument(std::string(name) + " has " + std::to_string(values(i)) +
                                  ", wanted 0 to " + std::to_string(length) + " less 1");
    }
  }
}

void bundle_arrays(const Indices<1>& scene, const Indices<1>& here, const Indices<1>& there,
                   const Floats<3>& surface, const Floats<3>& rays, const Floats<4>& precision,
                   const Floats<2>& depths, const Floats<2>& confidence,
                   const Floats<3>& positions_here, const Floats<3>& positions_there,
                   const Floats<4>& cameras, const Floats<3>& corrections,
                   const Floats<1>& log_focal, const Results<5>& hessian,
                   const Results<3>& gradient, const Results<1>& focal_hessian,
                   const Results<1>& focal_gradient, const Results<3>& focal_cross, int rows,
                   int columns, float nearest, float independence, float fine_depth,
                   float mutual_depth, float outlier, int threads) {
  const std::size_t scenes = cameras.shape(0), views = cameras.shape(1);
  const std::size_t observations = surface.shape(0), points = surface.shape(1);
  if (rows < 1 || columns < 1) throw std::invalid_argument("a view has no nodes");
  const std::size_t nodes = std::size_t(rows) * std::size_t(columns), parts = 6 + nodes;
  require_shape("scene", scene, {observations});
  require_shape("here", here, {observations});
  require_shape("there", there, {observations});
  require_shape("surface", surface, {observations, points, 3});
  require_shape("rays", rays, {observations, points, 2});
  require_shape("precision", precision, {observations, points, 2, 2});
  require_shape("depths", depths, {observations, points});
  require_shape("confidence", confidence, {observations, points});
  require_shape("positions_here", positions_here, {observations, points, 2});
  require_shape("positions_there", positions_there, {observations, points, 2});
  require_shape("cameras", cameras, {scenes, views, 4, 4});
  require_shape("corrections", corrections, {scenes, views, nodes});
  require_shape("log_focal", log_focal, {scenes});
  require_shape("hessian", hessian, {scenes, views, views, parts, parts});
  require_shape("gradient", gradient, {scenes, views, parts});
  require_shape("focal_hessian", focal_hessian, {scenes});
  require_shape("focal_gradient", focal_gradient, {scenes});
  require_shape("focal_cross", focal_cross, {scenes, views, parts});
  require_indices("scene", scene, scenes);
  require_indices("here", here, views);
  require_indices("there", there, views);
  BundleInputs in;
  in.scenes = require_length("scenes", scenes, MAX_LENGTH);
  in.views = require_length("views", views, MAX_LENGTH);
  in.observations = require_length("observations", observations, MAX_LENGTH);
  in.points = require_length("points", points, MAX_LENGTH);
  require_length("nodes", nodes, MAX_NODES);
  in.rows = rows;
  in.columns = columns;
  in.scene = scene.data();
  in.here = here.data();
  in.there = there.data();
  in.surface = surface.data();
  in.rays = rays.data();
  in.precision = precision.data();
  in.depths = depths.data();
  in.confidence = confidence.data();
  in.positions_here = positions_here.data();
  in.positions_there = positions_there.data();
  in.cameras = cameras.data();
  in.corrections = corrections.data();
  in.log_focal = log_focal.data();
  in.nearest = nearest;
  in.independence = independence;
  in.fine_depth = fine_depth;
  in.mutual_depth = mutual_depth;
  in.outlier = outlier;
  const nb::gil_scoped_release release;
  bundle_equations(in, {hessian.data(), gradient.data(), focal_hessian.data(),
                        focal_gradient.data(), focal_cross.data()}, threads);
}

}  // namespace
}  // namespace instok3d

NB_MODULE(_kernels, m) {
  m.def("align", &instok3d::align_arrays, nb::arg("own_photos"), nb::arg("photos"),
        nb::arg("centers"), nb::arg("depths"), nb::arg("peaks"), nb::arg("confidence"),
        nb::arg("warps"), nb::arg("shifts"), nb::arg("window"),
        // Not converted: results would be written to a copy.
        nb::arg("pixels").noconvert(), nb::arg("precision").noconvert(),
        nb::kw_only(), nb::arg("nearest"), nb::arg("largest_warp"), nb::arg("start_reach"),
        nb::arg("peak_reach"), nb::arg("nearest_error"), nb::arg("color_noise"),
        nb::arg("shared"), nb::arg("least_confidence"), nb::arg("iterations"),
        nb::arg("threads"));
  m.def("bundle_equations", &instok3d::bundle_arrays, nb::arg("scene"), nb::arg("here"),
        nb::arg("there"), nb::arg("surface"), nb::arg("rays"), nb::arg("precision"),
        nb::arg("depths"), nb::arg("confidence"), nb::arg("positions_here"),
        nb::arg("positions_there"), nb::arg("cameras"), nb::arg("corrections"),
        nb::arg("log_focal"), nb::arg("hessian").noconvert(), nb::arg("gradient").noconvert(),
        nb::arg("focal_hessian").noconvert(), nb::arg("focal_gradient").noconvert(),
        nb::arg("focal_cross").noconvert(), nb::kw_only(), nb::arg("rows"), nb::arg("columns"),
        nb::arg("nearest"), nb::arg("independence"), nb::arg("fine_depth"),
        nb::arg("mutual_depth"), nb::arg("outlier"), nb::arg("threads"));
}
