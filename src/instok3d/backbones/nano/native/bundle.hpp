// Normal equations of bundle adjustment, as `normal_equations` of bundle_equations.py defines them.
#pragma once

#include <cstdint>

namespace instok3d {

struct BundleInputs {
  int scenes, views, rows, columns;   // rows and columns of nodes in a view
  int observations, points;
  const std::int64_t *scene, *here, *there;  // [observation], in range
  const float* surface;               // [observation point 3], in the camera of here
  const float* rays;                  // [observation point 2], in the camera of there
  const float* precision;             // [observation point 2 2]
  const float* depths;                // [observation point], of there
  const float* confidence;            // [observation point]
  const float *positions_here, *positions_there;  // [observation point 2], shares of the image
  const float* cameras;               // [scene view 4 4], from the first camera
  const float* corrections;           // [scene view node], of log depth
  const float* log_focal;             // [scene]
  float nearest;                      // least depth in front of a camera
  float independence, fine_depth, mutual_depth, outlier;  // of the expected errors

  int nodes() const { return rows * columns; }
  int parts() const { return 6 + nodes(); }  // unknowns of a view: its twist, its corrections
};

struct BundleOutputs {
  float* hessian;         // [scene view view part part]
  float* gradient;        // [scene view part]
  float* focal_hessian;   // [scene]
  float* focal_gradient;  // [scene]
  float* focal_cross;     // [scene view part]
};

// Sums over the points run in a fixed order: any number of threads gives the same bits.
void bundle_equations(const BundleInputs& in, const BundleOutputs& out, int threads);

}  // namespace instok3d
