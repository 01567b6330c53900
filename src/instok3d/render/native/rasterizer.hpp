// A call from Python: all views of all scenes, forward and backward.
#pragma once

#include <memory>
#include <vector>

#include "binning.hpp"
#include "kernels.hpp"

namespace instok3d {

// What a forward pass leaves for its backward pass.
struct Frame {
  explicit Frame(const Sizes& drawn) : sizes(drawn) {}
  Frame(const Frame&) = delete;
  Sizes sizes;  // of what was drawn: a backward pass of others would read beyond the lists
  std::vector<Camera> cameras;
  std::vector<Bins> pictures;
  std::vector<std::int32_t> slots;  // anchors in each tile of each picture
};

// Draws all pictures; the images of picture p start at p times the size of one.
// Throws std::out_of_range when an anchor index has no row of features.
std::unique_ptr<Frame> draw_all(const Inputs&, const Kernels&, const Images&, int threads);

struct Gradients {
  InputGradients gaussians;
  float* features;         // scenes x anchors x channels; may be null
  float* cam_from_world;   // pictures x 4 x 4
};

// Gradients of all inputs; the images are those that the forward pass drew, images without a
// gradient are null.
void draw_all_backward(const Inputs&, const Kernels&, const Frame&, const ConstImages& images,
                       const ConstImages& grads, const Gradients&, int threads);

}  // namespace instok3d
