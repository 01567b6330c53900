#include "bundle.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "team.hpp"

namespace instok3d {
namespace {

// Derivatives of a residual by the six parts of the twist of camera there and by the log focal
// length, and the residual itself.
typedef float Row __attribute__((vector_size(32)));
constexpr int FOCAL = 6, VALUE = 7;

// What camera there sees of camera here.
struct Relative {
  float rotation[9], translation[3];
};

Relative there_from_here(const float* here, const float* there) {
  Relative relative;
  for (int i = 0; i < 3; ++i) {
    double moved = there[4 * i + 3];
    for (int j = 0; j < 3; ++j) {
      double turned = 0;
      for (int k = 0; k < 3; ++k) turned += double(there[4 * i + k]) * here[4 * j + k];
      relative.rotation[3 * i + j] = float(turned);
      moved -= turned * here[4 * j + 3];
    }
    relative.translation[i] = float(moved);
  }
  return relative;
}

// The four nodes about a place and their bilinear weights, as `node_weights` has them.
struct Nodes {
  int index[4];
  float weight[4];

  Nodes(const float* position, int rows, int columns) {
    // In this order of the arguments NaN becomes 0.
    const float x = std::min(std::max(0.0f, position[0] * columns - 0.5f), float(columns - 1));
    const float y = std::min(std::max(0.0f, position[1] * rows - 0.5f), float(rows - 1));
    const int left = int(x), top = int(y);
    const int right = std::min(left + 1, columns - 1), bottom = std::min(top + 1, rows - 1);
    const float share_x = x - float(left), share_y = y - float(top);
    index[0] = top * columns + left, weight[0] = (1 - share_x) * (1 - share_y);
    index[1] = top * columns + right, weight[1] = share_x * (1 - share_y);
    index[2] = bottom * columns + left, weight[2] = (1 - share_x) * share_y;
    index[3] = bottom * columns + right, weight[3] = share_x * share_y;
  }

  float sum(const float* values) const {
    float total = 0;
    for (int k = 0; k < 4; ++k) total += weight[k] * values[index[k]];
    return total;
  }
};

// The three residuals of a point, whitened and robustly weighted: x/z, y/z and log depth.
struct Residuals {
  Row rows[3];
  float by_here[3];  // by the log depth of the point in view here
  float by_there;    // of the last residual by the log depth of its match in view there
};

// What an observation of one view in another adds up: products of its rows, and of the
// corrections of both views with the rows and with each other.
class Sums {
 public:
  Sums(float* memory, int nodes) : nodes_(nodes) {
    core = memory;
    here = core + 64;
    there = here + 8 * nodes;
    here_here = there + 8 * nodes;
    here_there = here_here + nodes * nodes;
    there_there = here_there + nodes * nodes;
  }
  static std::size_t size(int nodes) {
    return 64 + 16 * std::size_t(nodes) + 3 * std::size_t(nodes) * nodes;
  }

  void add(const Residuals& r, const Nodes& at_here, const Nodes& at_there) {
    Row by_here = {}, by_there = r.by_there * r.rows[2];
    float square_here = 0;
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 8; ++k) add_row(core + 8 * k, r.rows[i][k] * r.rows[i]);
      by_here += r.by_here[i] * r.rows[i];
      square_here += r.by_here[i] * r.by_here[i];
    }
    const float mixed = r.by_here[2] * r.by_there, square_there = r.by_there * r.by_there;
    for (int k = 0; k < 4; ++k) {
      const int a = at_here.index[k], b = at_there.index[k];
      add_row(here + 8 * a, at_here.weight[k] * by_here);
      add_row(there + 8 * b, at_there.weight[k] * by_there);
      for (int other = 0; other < 4; ++other) {
        const float weight_here = at_here.weight[k] * square_here;
        here_here[a * nodes_ + at_here.index[other]] += weight_here * at_here.weight[other];
        here_there[a * nodes_ + at_there.index[other]] +=
            at_here.weight[k] * mixed * at_there.weight[other];
        there_there[b * nodes_ + at_there.index[other]] +=
            at_there.weight[k] * square_there * at_there.weight[other];
      }
    }
  }

  float *core, *here, *there, *here_here, *here_there, *there_there;

 private:
  static void add_row(float* to, Row row) {
    Row before;
    std::memcpy(&before, to, sizeof before);
    before += row;
    std::memcpy(to, &before, sizeof before);
  }
  int nodes_;
};

// Whitening matrix [[x, xy], [0, y]] of the reprojection errors. An error of the depth moves the
// projection along the parallax; the inverse of the covariance follows by Sherman-Morrison.
struct Root {
  float x, xy, y;

  Root(const float* precision, float parallax_x, float parallax_y, float fine_depth) {
    const float px = precision[0] * parallax_x + precision[1] * parallax_y;
    const float py = precision[2] * parallax_x + precision[3] * parallax_y;
    const float variance = fine_depth * fine_depth;
    const float loss = variance / (1 + variance * (parallax_x * px + parallax_y * py));
    x = std::sqrt(std::max(precision[0] - loss * px * px, 1e-9f));
    xy = (precision[1] - loss * px * py) / x;
    y = std::sqrt(std::max(precision[3] - loss * py * py - xy * xy, 1e-9f));
  }
};

// False for a point without weight.
bool residuals_of(const BundleInputs& in, std::int64_t point, const Relative& relative, float focal,
                  float correction_here, float correction_there, Residuals& out) {
  const float* R = relative.rotation;
  const float* from = in.surface + 3 * point;
  const float scale = std::exp(correction_here);
  const float across[2] = {from[0] / focal * scale, from[1] / focal * scale};
  float rotated[3], inward[3], seen[3];
  for (int i = 0; i < 3; ++i) {
    const float flat = R[3 * i] * across[0] + R[3 * i + 1] * across[1];
    inward[i] = -flat;
    rotated[i] = flat + R[3 * i + 2] * (from[2] * scale);
    seen[i] = rotated[i] + relative.translation[i];
  }
  const float share = in.independence * in.confidence[point];
  if (share == 0 || seen[2] <= in.nearest) return false;

  // 1. Residuals. The projection is compared at the initial focal length, that is in pixels.
  const float w = 1 / seen[2], u = seen[0] * w, v = seen[1] * w;
  const float* ray = in.rays + 2 * point;
  const float error_x = focal * u - ray[0], error_y = focal * v - ray[1];
  const float observed = std::max(in.depths[point], in.nearest);
  const float error_z = std::log(seen[2] / observed) - correction_there;

  // 2. Derivatives.
  const float here_x = focal * w * (rotated[0] - u * rotated[2]);
  const float here_y = focal * w * (rotated[1] - v * rotated[2]);
  const float here_z = rotated[2] * w;
  const float focal_x = focal * (u + w * (inward[0] - u * inward[2]));
  const float focal_y = focal * (v + w * (inward[1] - v * inward[2]));
  const float f = focal;
  const Row x = {f * w, 0, -f * u * w, -f * u * v, f * (1 + u * u), -f * v, focal_x, error_x};
  const Row y = {0, f * w, -f * v * w, -f * (1 + v * v), f * u * v, f * u, focal_y, error_y};
  const Row z = {0, 0, w, v, -u, 0, inward[2] * w, error_z};

  // 3. Whitened, and weighted by confidence and robustly (Cauchy), the ray and the depth apart.
  const Root root(in.precision + 4 * point, here_x, here_y, in.fine_depth);
  const float depth_root = 1 / in.mutual_depth;
  out.rows[0] = root.x * x + root.xy * y;
  out.rows[1] = root.y * y;
  out.rows[2] = depth_root * z;
  const float off_x = out.rows[0][VALUE], off_y = out.rows[1][VALUE], off_z = out.rows[2][VALUE];
  const float square = 1 / (in.outlier * in.outlier);
  const float of_ray = std::sqrt(share / (1 + (off_x * off_x + off_y * off_y) * square));
  const float of_depth = std::sqrt(share / (1 + off_z * off_z * square));
  out.rows[0] *= of_ray;
  out.rows[1] *= of_ray;
  out.rows[2] *= of_depth;
  out.by_here[0] = of_ray * (root.x * here_x + root.xy * here_y);
  out.by_here[1] = of_ray * root.y * here_y;
  out.by_here[2] = of_depth * depth_root * here_z;
  out.by_there = -of_depth * depth_root;
  return true;
}

const float* camera_of(const BundleInputs& in, std::int64_t scene, std::int64_t view) {
  return in.cameras + 16 * (scene * in.views + view);
}

// Adds up all points of one observation.
void sum_points(const BundleInputs& in, int observation, Sums& sums) {
  const std::int64_t scene = in.scene[observation];
  const std::int64_t here = in.here[observation], there = in.there[observation];
  const Relative relative =
      there_from_here(camera_of(in, scene, here), camera_of(in, scene, there));
  const float focal = std::exp(in.log_focal[scene]);
  const float* of_here = in.corrections + (scene * in.views + here) * in.nodes();
  const float* of_there = in.corrections + (scene * in.views + there) * in.nodes();
  for (int p = 0; p < in.points; ++p) {
    const std::int64_t point = std::int64_t(observation) * in.points + p;
    if (in.confidence[point] == 0) continue;
    const Nodes at_here(in.positions_here + 2 * point, in.rows, in.columns);
    const Nodes at_there(in.positions_there + 2 * point, in.rows, in.columns);
    Residuals residuals;
    if (residuals_of(in, point, relative, focal, at_here.sum(of_here), at_there.sum(of_there),
                     residuals)) {
      sums.add(residuals, at_here, at_there);
    }
  }
}

// A small motion of camera here changes the projection as the opposite motion of camera there,
// expressed in the frame of there: the adjoint of there_from_here, negated.
struct Carry {
  float matrix[36];

  explicit Carry(const Relative& relative) {
    const float *R = relative.rotation, *t = relative.translation;
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      for (int column = 0; column < 3; ++column) {
        matrix[6 * i + column] = matrix[6 * (i + 3) + 3 + column] = -R[3 * i + column];
        matrix[6 * i + 3 + column] = -(t[j] * R[3 * k + column] - t[k] * R[3 * j + column]);
        matrix[6 * (i + 3) + column] = 0;
      }
    }
  }

  // The transposed matrix times (from[0], from[stride], ...).
  void apply(const float* from, int stride, float (&to)[6]) const {
    for (int column = 0; column < 6; ++column) {
      to[column] = 0;
      for (int k = 0; k < 6; ++k) to[column] += matrix[6 * k + column] * from[k * stride];
    }
  }
};

// Adds an observation to the rows of the view that it is seen in (there) or that is seen (here).
class Rows {
 public:
  Rows(const BundleInputs& in, const BundleOutputs& out, std::int64_t scene, std::int64_t view)
      : in_(in), nodes_(in.nodes()), parts_(in.parts()) {
    const std::int64_t row = scene * in.views + view;
    hessian_ = out.hessian + row * in.views * parts_ * parts_;
    gradient_ = out.gradient + row * parts_;
    cross_ = out.focal_cross + row * parts_;
    std::memset(hessian_, 0, sizeof(float) * in.views * parts_ * parts_);
    std::memset(gradient_, 0, sizeof(float) * parts_);
    std::memset(cross_, 0, sizeof(float) * parts_);
  }

  void add_there(const Sums& s, const Carry& carry, std::int64_t here, std::int64_t there) {
    float* own = block(there);
    float* other = block(here);
    float carried[6];
    for (int row = 0; row < 6; ++row) {
      carry.apply(s.core + 8 * row, 1, carried);
      for (int k = 0; k < 6; ++k) {
        own[row * parts_ + k] += s.core[8 * row + k];
        other[row * parts_ + k] += carried[k];
      }
      for (int node = 0; node < nodes_; ++node) {
        own[row * parts_ + 6 + node] += s.there[8 * node + row];
        other[row * parts_ + 6 + node] += s.here[8 * node + row];
      }
      gradient_[row] += s.core[8 * row + VALUE];
      cross_[row] += s.core[8 * row + FOCAL];
    }
    for (int node = 0; node < nodes_; ++node) {
      const std::int64_t row = std::int64_t(6 + node) * parts_;
      carry.apply(s.there + 8 * node, 1, carried);
      for (int k = 0; k < 6; ++k) {
        own[row + k] += s.there[8 * node + k];
        other[row + k] += carried[k];
      }
      for (int k = 0; k < nodes_; ++k) {
        own[row + 6 + k] += s.there_there[node * nodes_ + k];
        other[row + 6 + k] += s.here_there[k * nodes_ + node];
      }
      gradient_[6 + node] += s.there[8 * node + VALUE];
      cross_[6 + node] += s.there[8 * node + FOCAL];
    }
  }

  void add_here(const Sums& s, const Carry& carry, std::int64_t here, std::int64_t there) {
    float* own = block(here);
    float* other = block(there);
    float carried[6], turned[36], row_of[6];
    for (int column = 0; column < 6; ++column) {  // turned = carry^T core
      carry.apply(s.core + column, 8, carried);
      for (int k = 0; k < 6; ++k) turned[6 * k + column] = carried[k];
    }
    for (int row = 0; row < 6; ++row) {
      carry.apply(turned + 6 * row, 1, row_of);
      for (int k = 0; k < 6; ++k) {
        own[row * parts_ + k] += row_of[k];
        other[row * parts_ + k] += turned[6 * row + k];
      }
    }
    for (int node = 0; node < nodes_; ++node) {
      const std::int64_t row = std::int64_t(6 + node) * parts_;
      float carried_there[6];
      carry.apply(s.here + 8 * node, 1, carried);
      carry.apply(s.there + 8 * node, 1, carried_there);
      for (int k = 0; k < 6; ++k) {
        own[k * parts_ + 6 + node] += carried[k];
        other[k * parts_ + 6 + node] += carried_there[k];
        own[row + k] += carried[k];
        other[row + k] += s.here[8 * node + k];
      }
      for (int k = 0; k < nodes_; ++k) {
        own[row + 6 + k] += s.here_here[node * nodes_ + k];
        other[row + 6 + k] += s.here_there[node * nodes_ + k];
      }
      gradient_[6 + node] += s.here[8 * node + VALUE];
      cross_[6 + node] += s.here[8 * node + FOCAL];
    }
    carry.apply(s.core + VALUE, 8, carried);
    for (int k = 0; k < 6; ++k) gradient_[k] += carried[k];
    carry.apply(s.core + FOCAL, 8, carried);
    for (int k = 0; k < 6; ++k) cross_[k] += carried[k];
  }

 private:
  float* block(std::int64_t view) const { return hessian_ + view * parts_ * parts_; }

  const BundleInputs& in_;
  int nodes_;
  std::int64_t parts_;
  float *hessian_, *gradient_, *cross_;
};

}  // namespace

void bundle_equations(const BundleInputs& in, const BundleOutputs& out, int threads) {
  const std::size_t size = Sums::size(in.nodes());
  std::vector<float> memory(size * in.observations);
  const auto sums_of = [&](int observation) {
    return Sums(memory.data() + size * observation, in.nodes());
  };
  const Stage points = {[&] { return std::int64_t(in.observations); },
                        [&](std::int64_t observation, int) {
                          Sums sums = sums_of(int(observation));
                          sum_points(in, int(observation), sums);
                        }};
  const Stage views = {[&] { return std::int64_t(in.scenes) * in.views; },
                       [&](std::int64_t task, int) {
                         const std::int64_t scene = task / in.views, view = task % in.views;
                         Rows rows(in, out, scene, view);
                         float hessian = 0, gradient = 0;
                         for (int o = 0; o < in.observations; ++o) {
                           if (in.scene[o] != scene) continue;
                           const std::int64_t here = in.here[o], there = in.there[o];
                           const Sums sums = sums_of(o);
                           const Carry carry(there_from_here(camera_of(in, scene, here),
                                                             camera_of(in, scene, there)));
                           if (there == view) rows.add_there(sums, carry, here, there);
                           if (here == view) rows.add_here(sums, carry, here, there);
                           hessian += sums.core[8 * FOCAL + FOCAL];
                           gradient += sums.core[8 * FOCAL + VALUE];
                         }
                         if (view == 0) {
                           out.focal_hessian[scene] = hessian;
                           out.focal_gradient[scene] = gradient;
                         }
                       }};
  run_stages(usable_threads(threads), {points, views});
}

}  // namespace instok3d
