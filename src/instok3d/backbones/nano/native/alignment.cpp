#include "alignment.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "team.hpp"

namespace instok3d {
namespace {

constexpr int PIXELS = PATCH * PATCH;
constexpr int CELLS_OF_A_TASK = 32;

// Red, green, blue and nothing. Four floats are a register of every x86-64 and arm64.
typedef float Quad __attribute__((vector_size(16)));

float total(Quad q) { return (q[0] + q[1]) + (q[2] + q[3]); }

// A pixel as it is searched in: its colour, and how that changes to the right and downwards.
struct Texel {
  Quad color, by_x, by_y;
};

Quad color_at(const float* photo, int height, int width, int row, int column) {
  const std::int64_t plane = std::int64_t(height) * width, at = std::int64_t(row) * width + column;
  return Quad{photo[at], photo[plane + at], photo[2 * plane + at], 0.0f};
}

void prepare_row(const AlignmentInputs& in, int scene, int row, Texel* texels) {
  const float* photo = in.photos + std::int64_t(scene) * 3 * in.height * in.width;
  const int above = std::max(row - 1, 0), below = std::min(row + 1, in.height - 1);
  const auto color = [&](int r, int c) { return color_at(photo, in.height, in.width, r, c); };
  for (int column = 0; column < in.width; ++column) {
    const int left = std::max(column - 1, 0), right = std::min(column + 1, in.width - 1);
    texels[column] = {color(row, column), 0.5f * (color(row, right) - color(row, left)),
                      0.5f * (color(below, column) - color(above, column))};
  }
}

// The four pixels about each place of a patch, by their number in the photo, and their shares;
// places outside are those of the edge.
struct Corners {
  std::int32_t a[PIXELS], b[PIXELS], d[PIXELS], e[PIXELS];
  float share_a[PIXELS], share_b[PIXELS], share_d[PIXELS], share_e[PIXELS];
};

// All pixels in one plain loop, which compilers turn into vector instructions: two thirds of the
// time of the search with one pixel after the other.
void find_corners(const float* by_x, const float* by_y, const float at[2], int height, int width,
                  Corners& found) {
  const float at_x = at[0], at_y = at[1];
  const float last_x = float(width - 1), last_y = float(height - 1);
  for (int p = 0; p < PIXELS; ++p) {
    float x = at_x + by_x[p] - 0.5f, y = at_y + by_y[p] - 0.5f;
    x = 0.0f < x ? x : 0.0f;  // NaN becomes 0
    y = 0.0f < y ? y : 0.0f;
    x = last_x < x ? last_x : x;
    y = last_y < y ? last_y : y;
    const std::int32_t left = std::int32_t(x), top = std::int32_t(y);
    const std::int32_t right = left < width - 1 ? 1 : 0, below = top < height - 1 ? width : 0;
    x -= float(left);
    y -= float(top);
    found.a[p] = top * width + left;
    found.b[p] = found.a[p] + right;
    found.d[p] = found.a[p] + below;
    found.e[p] = found.d[p] + right;
    found.share_a[p] = (1 - x) * (1 - y);
    found.share_b[p] = x * (1 - y);
    found.share_d[p] = (1 - x) * y;
    found.share_e[p] = x * y;
  }
}

// The patch as the other photo should show it: its colours, and its pixels about their middle.
struct Patch {
  Quad colors[PIXELS];
  float x[PIXELS], y[PIXELS];
};

Patch warp_patch(const AlignmentInputs& in, int scene, int cell, float start[2]) {
  const float* warp = in.warps + std::int64_t(scene) * 9;
  const float* shift = in.shifts + std::int64_t(scene) * 3;
  const float* photo = in.own_photos + std::int64_t(scene) * 3 * in.own_height * in.own_width;
  const float* peak = in.peaks + (std::int64_t(scene) * in.cells + cell) * 2;
  const float depth = in.depths[std::int64_t(scene) * in.cells + cell];
  Patch patch;
  float middle_x = 0, middle_y = 0;
  bool front = true;
  for (int p = 0; p < PIXELS; ++p) {
    const float x = in.centers[cell * 2] + float(p % PATCH) + 0.5f * (1 - PATCH);
    const float y = in.centers[cell * 2 + 1] + float(p / PATCH) + 0.5f * (1 - PATCH);
    // In this order of the arguments NaN becomes 0.
    const int column = int(std::min(std::max(0.0f, std::floor(x)), float(in.own_width - 1)));
    const int row = int(std::min(std::max(0.0f, std::floor(y)), float(in.own_height - 1)));
    patch.colors[p] = color_at(photo, in.own_height, in.own_width, row, column);
    float seen[3];
    for (int axis = 0; axis < 3; ++axis) {
      const float* w = warp + 3 * axis;
      seen[axis] = depth * (w[0] * x + w[1] * y + w[2]) + shift[axis];
    }
    front = front && seen[2] > in.nearest;
    const float z = std::max(seen[2], in.nearest);
    patch.x[p] = seen[0] / z;
    patch.y[p] = seen[1] / z;
    middle_x += patch.x[p] / PIXELS;
    middle_y += patch.y[p] / PIXELS;
  }
  float reach = 0;
  for (int p = 0; p < PIXELS; ++p) {
    patch.x[p] -= middle_x;
    patch.y[p] -= middle_y;
    reach = std::max(reach, std::max(std::abs(patch.x[p]), std::abs(patch.y[p])));
  }
  if (!(front && reach < in.largest_warp)) {
    for (int p = 0; p < PIXELS; ++p) {
      patch.x[p] = float(p % PATCH) + 0.5f * (1 - PATCH);
      patch.y[p] = float(p / PATCH) + 0.5f * (1 - PATCH);
    }
  }
  const bool near = front && std::hypot(middle_x - peak[0], middle_y - peak[1]) < in.start_reach;
  start[0] = near ? middle_x : peak[0];
  start[1] = near ? middle_y : peak[1];
  return patch;
}

// What each pixel of a patch counts in the mean, and its precision where the photos agree.
struct Weights {
  float shares[PIXELS], precision[PIXELS];
};

Weights weights_of(const AlignmentInputs& in) {
  float window_total = 0;
  for (int p = 0; p < PIXELS; ++p) window_total += in.window[p];
  const float precision = 1 / (in.shared * in.color_noise * in.color_noise);
  Weights weights;
  for (int p = 0; p < PIXELS; ++p) {
    weights.shares[p] = in.window[p] / window_total;
    weights.precision[p] = precision * in.window[p];
  }
  return weights;
}

// Normal equations of the colour differences over the place, in units of their noise.
struct Equations {
  float xx, xy, yy, x, y;
};

Equations photo_equations(const AlignmentInputs& in, const Texel* texels, const Patch& patch,
                          const float at[2], const Weights& weights) {
  Corners corners;
  find_corners(patch.x, patch.y, at, in.height, in.width, corners);
  Texel found[PIXELS];
  Texel mean = {};
  for (int p = 0; p < PIXELS; ++p) {
    const Texel &a = texels[corners.a[p]], &b = texels[corners.b[p]];
    const Texel &d = texels[corners.d[p]], &e = texels[corners.e[p]];
    const float share_a = corners.share_a[p], share_b = corners.share_b[p];
    const float share_d = corners.share_d[p], share_e = corners.share_e[p];
    const float share = weights.shares[p];
    found[p].color = share_a * a.color + share_b * b.color + share_d * d.color +
                     share_e * e.color - patch.colors[p];
    found[p].by_x = share_a * a.by_x + share_b * b.by_x + share_d * d.by_x + share_e * e.by_x;
    found[p].by_y = share_a * a.by_y + share_b * b.by_y + share_d * d.by_y + share_e * e.by_y;
    mean.color += share * found[p].color;
    mean.by_x += share * found[p].by_x;
    mean.by_y += share * found[p].by_y;
  }
  const float scale = 2 * in.color_noise;
  const float per_square = 1 / (3 * scale * scale);
  float robust[PIXELS];
  for (int p = 0; p < PIXELS; ++p) {
    found[p].color -= mean.color;
    robust[p] = total(found[p].color * found[p].color);
  }
  for (int p = 0; p < PIXELS; ++p) robust[p] = weights.precision[p] / (1 + robust[p] * per_square);
  Quad xx = {}, xy = {}, yy = {}, x = {}, y = {};
  for (int p = 0; p < PIXELS; ++p) {
    const Quad error = found[p].color;
    const Quad by_x = found[p].by_x - mean.by_x, by_y = found[p].by_y - mean.by_y;
    const Quad weighted_x = robust[p] * by_x, weighted_y = robust[p] * by_y;
    xx += weighted_x * by_x;
    xy += weighted_x * by_y;
    yy += weighted_y * by_y;
    x += weighted_x * error;
    y += weighted_y * error;
  }
  return {total(xx), total(xy), total(yy), total(x), total(y)};
}

void align_cell(const AlignmentInputs& in, const Texel* texels, int scene, int cell,
                const Weights& weights, const AlignmentOutputs& out) {
  float at[2];
  const Patch patch = warp_patch(in, scene, cell, at);
  const std::int64_t row = std::int64_t(scene) * in.cells + cell;
  const float* peak = in.peaks + row * 2;
  const float held = 1 / (in.peak_reach * in.peak_reach);
  Equations e = {held, 0, held, 0, 0};
  for (int iteration = 0; iteration < in.iterations; ++iteration) {
    e = photo_equations(in, texels, patch, at, weights);
    e.xx += held;
    e.yy += held;
    e.x += (at[0] - peak[0]) * held;
    e.y += (at[1] - peak[1]) * held;
    const float determinant = e.xx * e.yy - e.xy * e.xy;
    const float step_x = (e.xy * e.y - e.yy * e.x) / determinant;
    const float step_y = (e.xy * e.x - e.xx * e.y) / determinant;
    const float shorter = 1 / std::max(std::hypot(step_x, step_y), 1.0f);
    at[0] += step_x * shorter;
    at[1] += step_y * shorter;
  }
  // The inverse of (the inverse of the precision, and the floor).
  const float determinant = e.xx * e.yy - e.xy * e.xy;
  const float floor = in.nearest_error * in.nearest_error;
  const float xx = e.yy / determinant + floor, yy = e.xx / determinant + floor;
  const float xy = -e.xy / determinant;
  const float other = xx * yy - xy * xy;
  float* precision = out.precision + row * 4;
  precision[0] = yy / other;
  precision[1] = precision[2] = -xy / other;
  precision[3] = xx / other;
  out.pixels[row * 2] = at[0];
  out.pixels[row * 2 + 1] = at[1];
}

}  // namespace

void align(const AlignmentInputs& in, const AlignmentOutputs& out, int threads) {
  const int tasks = (in.cells + CELLS_OF_A_TASK - 1) / CELLS_OF_A_TASK;
  const Weights weights = weights_of(in);
  std::vector<Texel> texels(std::size_t(in.height) * in.width);  // of one scene after the other
  std::vector<Stage> stages;
  for (int scene = 0; scene < in.scenes; ++scene) {
    stages.push_back({[&] { return std::int64_t(in.height); },
                      [&, scene](std::int64_t row, int) {
                        prepare_row(in, scene, int(row), texels.data() + row * in.width);
                      }});
    stages.push_back({[&] { return std::int64_t(tasks); },
                      [&, scene](std::int64_t task, int) {
                        const int first = int(task) * CELLS_OF_A_TASK;
                        const int end = std::min(first + CELLS_OF_A_TASK, in.cells);
                        for (int cell = first; cell < end; ++cell) {
                          const std::int64_t at = std::int64_t(scene) * in.cells + cell;
                          if (!(in.confidence[at] > in.least_confidence)) continue;
                          align_cell(in, texels.data(), scene, cell, weights, out);
                        }
                      }});
  }
  run_stages(usable_threads(threads), stages);
}

}  // namespace instok3d
