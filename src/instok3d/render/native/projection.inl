// Projection of single Gaussians and its gradients, in double precision inside: determinants of
// thin projected Gaussians cancel, and in float their quaternions' gradients lose three digits.

namespace {

constexpr double LOG2E = 1.4426950408889634;

// The linear algebra of one Gaussian in one camera that both directions need.
struct Shape {
  double mean[3];                   // in the camera's frame
  double turn[9], quat[4], inverse_norm;
  double axes[9];                   // camera rotation x turn x scales
  double slope[2], cut[2];          // x/z, y/z, and the same within the Jacobian's limits
  double row_x[3], row_y[3];        // Jacobian x axes
  double xx, xy, yy, determinant;   // 2D covariance
};

inline bool shape_of(const Inputs& in, const Camera& camera, const float* mean, const float* quat,
                     const float* scale, Shape& s) {
  const double* R = camera.rotation;
  for (int i = 0; i < 3; ++i) {
    s.mean[i] = R[3 * i] * mean[0] + R[3 * i + 1] * mean[1] + R[3 * i + 2] * mean[2] +
                camera.translation[i];
  }
  const double z = s.mean[2];
  if (!(z > in.near && z < in.far)) return false;
  double norm = 0;
  for (int i = 0; i < 4; ++i) norm += double(quat[i]) * quat[i];
  s.inverse_norm = 1 / std::sqrt(norm < 1e-24 ? 1e-24 : norm);
  for (int i = 0; i < 4; ++i) s.quat[i] = quat[i] * s.inverse_norm;
  const double qw = s.quat[0], qx = s.quat[1], qy = s.quat[2], qz = s.quat[3];
  const double turn[9] = {
      1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy),
      2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx),
      2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)};
  for (int i = 0; i < 9; ++i) s.turn[i] = turn[i];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      s.axes[3 * i + j] =
          (R[3 * i] * turn[j] + R[3 * i + 1] * turn[3 + j] + R[3 * i + 2] * turn[6 + j]) *
          scale[j];
    }
  }
  const double inverse_z = 1 / z;
  s.slope[0] = s.mean[0] * inverse_z;
  s.slope[1] = s.mean[1] * inverse_z;
  s.cut[0] = s.slope[0] < camera.lowest_x    ? camera.lowest_x
             : s.slope[0] > camera.highest_x ? camera.highest_x
                                             : s.slope[0];
  s.cut[1] = s.slope[1] < camera.lowest_y    ? camera.lowest_y
             : s.slope[1] > camera.highest_y ? camera.highest_y
                                             : s.slope[1];
  const double scale_x = camera.focal_x * inverse_z, scale_y = camera.focal_y * inverse_z;
  double xx = 0, xy = 0, yy = 0;
  for (int j = 0; j < 3; ++j) {
    s.row_x[j] = scale_x * (s.axes[j] - s.cut[0] * s.axes[6 + j]);
    s.row_y[j] = scale_y * (s.axes[3 + j] - s.cut[1] * s.axes[6 + j]);
    xx += s.row_x[j] * s.row_x[j];
    xy += s.row_x[j] * s.row_y[j];
    yy += s.row_y[j] * s.row_y[j];
  }
  s.xx = xx + in.eps2d;
  s.xy = xy;
  s.yy = yy + in.eps2d;
  s.determinant = s.xx * s.yy - xy * xy;
  return s.determinant > 0;
}

// Values of the spherical harmonics, in the order and with the signs of 3DGS.
template <int COUNT>
inline void sh_basis(float x, float y, float z, float (&b)[COUNT]) {
  const float xx = x * x, yy = y * y, zz = z * z;
  b[0] = 0.28209479177387814f;
  if constexpr (COUNT > 1) {
    b[1] = -0.4886025119029199f * y;
    b[2] = 0.4886025119029199f * z;
    b[3] = -0.4886025119029199f * x;
  }
  if constexpr (COUNT > 4) {
    b[4] = 1.0925484305920792f * x * y;
    b[5] = -1.0925484305920792f * y * z;
    b[6] = 0.31539156525252005f * (2 * zz - xx - yy);
    b[7] = -1.0925484305920792f * x * z;
    b[8] = 0.5462742152960396f * (xx - yy);
  }
  if constexpr (COUNT > 9) {
    b[9] = -0.5900435899266435f * y * (3 * xx - yy);
    b[10] = 2.890611442640554f * x * y * z;
    b[11] = -0.4570457994644658f * y * (4 * zz - xx - yy);
    b[12] = 0.3731763325901154f * z * (2 * zz - 3 * xx - 3 * yy);
    b[13] = -0.4570457994644658f * x * (4 * zz - xx - yy);
    b[14] = 1.445305721320277f * z * (xx - yy);
    b[15] = -0.5900435899266435f * x * (xx - 3 * yy);
  }
}

// Gradient of sum_k weight[k] basis[k] with respect to (x, y, z).
template <int COUNT>
inline void sh_gradient(float x, float y, float z, const float (&w)[COUNT], float (&g)[3]) {
  g[0] = g[1] = g[2] = 0;
  if constexpr (COUNT > 1) {
    const float c = 0.4886025119029199f;
    g[0] -= c * w[3];
    g[1] -= c * w[1];
    g[2] += c * w[2];
  }
  if constexpr (COUNT > 4) {
    const float c = 1.0925484305920792f, d = 2 * 0.31539156525252005f,
                e = 2 * 0.5462742152960396f;
    g[0] += c * (y * w[4] - z * w[7]) + x * (e * w[8] - d * w[6]);
    g[1] += c * (x * w[4] - z * w[5]) - y * (e * w[8] + d * w[6]);
    g[2] += 2 * d * z * w[6] - c * (y * w[5] + x * w[7]);
  }
  if constexpr (COUNT > 9) {
    const float xx = x * x, yy = y * y, zz = z * z;
    const float a = -0.5900435899266435f, b = 2.890611442640554f, c = -0.4570457994644658f,
                d = 0.3731763325901154f, e = 1.445305721320277f;
    g[0] += 6 * a * x * y * w[9] + b * y * z * w[10] - 2 * c * x * y * w[11] -
            6 * d * x * z * w[12] + c * (4 * zz - 3 * xx - yy) * w[13] + 2 * e * x * z * w[14] +
            3 * a * (xx - yy) * w[15];
    g[1] += 3 * a * (xx - yy) * w[9] + b * x * z * w[10] + c * (4 * zz - xx - 3 * yy) * w[11] -
            6 * d * y * z * w[12] - 2 * c * x * y * w[13] - 2 * e * y * z * w[14] -
            6 * a * x * y * w[15];
    g[2] += b * x * y * w[10] + 8 * c * y * z * w[11] + 3 * d * (2 * zz - xx - yy) * w[12] +
            8 * c * x * z * w[13] + e * (xx - yy) * w[14];
  }
}

// Unit vector from the camera to the mean; returns the distance.
inline double direction_of(const Camera& camera, const float* mean, float (&direction)[3]) {
  double d[3], square = 0;
  for (int i = 0; i < 3; ++i) {
    d[i] = mean[i] - camera.position[i];
    square += d[i] * d[i];
  }
  const double distance = std::sqrt(square < 1e-24 ? 1e-24 : square);
  for (int i = 0; i < 3; ++i) direction[i] = static_cast<float>(d[i] / distance);
  return distance;
}

// Colour before the cut at 0.
template <int COUNT>
inline void color_of(const Camera& camera, const float* mean, const float* sh, float (&color)[3]) {
  float basis[COUNT], direction[3] = {0, 0, 1};
  if (COUNT > 1) direction_of(camera, mean, direction);
  sh_basis<COUNT>(direction[0], direction[1], direction[2], basis);
  for (int c = 0; c < 3; ++c) color[c] = 0.5f;
  for (int k = 0; k < COUNT; ++k) {
    for (int c = 0; c < 3; ++c) color[c] += basis[k] * sh[3 * k + c];
  }
}

template <int COUNT>
inline bool project_one(const Inputs& in, const Camera& camera, std::int64_t i, Record& r) {
  r.reach = -1;
  const double opacity = in.opacities[i];
  if (!(opacity >= in.alpha_min && opacity <= 3e38)) return false;
  Shape s;
  if (!shape_of(in, camera, in.means + 3 * i, in.quats + 4 * i, in.scales + 3 * i, s)) return false;
  const double inverse = 1 / s.determinant;
  const double conic_xx = s.yy * inverse, conic_xy = -s.xy * inverse, conic_yy = s.xx * inverse;
  const double x = camera.focal_x * s.slope[0] + camera.center_x;
  const double y = camera.focal_y * s.slope[1] + camera.center_y;
  const double reach = 2 * std::log(opacity / in.alpha_min);
  const double extent_x = std::sqrt(reach * s.xx), extent_y = std::sqrt(reach * s.yy);
  float color[3];
  color_of<COUNT>(camera, in.means + 3 * i, in.sh + 3 * COUNT * i, color);
  // Written so that a NaN anywhere makes it false.
  const bool seen = x + extent_x > 0 && x - extent_x < in.width && y + extent_y > 0 &&
                    y - extent_y < in.height && conic_xx < 1e30 && conic_yy < 1e30 &&
                    std::fabs(conic_xy) < 1e30 && std::fabs(color[0]) < 1e30f &&
                    std::fabs(color[1]) < 1e30f && std::fabs(color[2]) < 1e30f &&
                    std::fabs(x) < 1e30 && std::fabs(y) < 1e30;
  if (!seen) return false;
  r.x = x;
  r.y = y;
  // The smallest curvature keeps the ratios below finite; over a picture it is nothing.
  r.xx = -0.5 * LOG2E * (conic_xx > 1e-30 ? conic_xx : 1e-30);
  r.xy = -LOG2E * conic_xy;
  r.yy = -0.5 * LOG2E * (conic_yy > 1e-30 ? conic_yy : 1e-30);
  r.log_opacity = std::log2(opacity);
  r.x_per_y = s.xy / s.yy;
  r.y_per_x = s.xy / s.xx;
  r.red = color[0] > 0 ? color[0] : 0;
  r.green = color[1] > 0 ? color[1] : 0;
  r.blue = color[2] > 0 ? color[2] : 0;
  r.depth = s.mean[2];
  r.extent_x = extent_x < 1e30 ? extent_x + 1e-3 : 1e30;
  r.extent_y = extent_y < 1e30 ? extent_y + 1e-3 : 1e30;
  r.reach = reach + 1e-3;
  return true;
}

template <int COUNT>
inline bool project_count(const Inputs& in, const Camera& camera, int scene, int begin, int end,
                          Record* records) {
  bool anchors_exist = true;
  const std::int64_t base = std::int64_t(scene) * in.gaussians;
  for (int g = begin; g < end; ++g) {
    Record& r = records[g];
    const std::int64_t anchor = in.anchor_index[base + g];
    anchors_exist = anchors_exist && anchor >= 0 && anchor < in.anchors;
    r.anchor = static_cast<std::int32_t>(anchor);
    project_one<COUNT>(in, camera, base + g, r);
  }
  return anchors_exist || !in.channels;
}

bool project(const Inputs& in, const Camera& camera, int scene, int begin, int end,
             Record* records) {
  switch (in.coefficients) {
    case 1: return project_count<1>(in, camera, scene, begin, end, records);
    case 4: return project_count<4>(in, camera, scene, begin, end, records);
    case 9: return project_count<9>(in, camera, scene, begin, end, records);
    default: return project_count<16>(in, camera, scene, begin, end, records);
  }
}

// Gradients of one Gaussian, summed over views in double.
struct Sums {
  double mean[3], quat[4], scale[3], opacity;
};

// `g` holds the sums over all pairs of v, v dx, v dy, v dx^2, v dx dy, v dy^2 with
// v = alpha dL/dalpha, and of w dL/d(red, green, blue, depth).
template <int COUNT>
inline void project_one_backward(const Inputs& in, const Camera& camera, std::int64_t i,
                                 const Record& r, const double (&g)[10], Sums& out, float* sh_out,
                                 double* camera_out) {
  const float *mean = in.means + 3 * i, *scale = in.scales + 3 * i;
  Shape s;
  if (!shape_of(in, camera, mean, in.quats + 4 * i, scale, s)) return;  // it was seen: never
  out.opacity += g[0] / in.opacities[i];
  const double inverse = 1 / s.determinant;
  const double A = s.yy * inverse, B = -s.xy * inverse, C = s.xx * inverse;
  // log alpha = ... - (A dx^2 + C dy^2) / 2 - B dx dy with d = mean - pixel.
  const double x_grad = -(A * g[1] + B * g[2]), y_grad = -(B * g[1] + C * g[2]);
  const double a = -0.5 * g[3], b = -0.5 * g[4], c = -0.5 * g[5];
  // Through the inverse: dCovariance = -Conic G Conic.
  const double t00 = A * a + B * b, t01 = A * b + B * c, t10 = B * a + C * b, t11 = B * b + C * c;
  const double xx = -(t00 * A + t01 * B), xy = -(t00 * B + t01 * C), yy = -(t10 * B + t11 * C);
  const double inverse_z = 1 / s.mean[2];
  const double scale_x = camera.focal_x * inverse_z, scale_y = camera.focal_y * inverse_z;
  double axes[9], focal_x = 0, focal_y = 0, cut_x = 0, cut_y = 0;
  for (int j = 0; j < 3; ++j) {
    const double vx = 2 * (xx * s.row_x[j] + xy * s.row_y[j]);
    const double vy = 2 * (xy * s.row_x[j] + yy * s.row_y[j]);
    axes[j] = vx * scale_x;
    axes[3 + j] = vy * scale_y;
    axes[6 + j] = -(axes[j] * s.cut[0] + axes[3 + j] * s.cut[1]);
    focal_x += vx * s.row_x[j];
    focal_y += vy * s.row_y[j];
    cut_x -= axes[j] * s.axes[6 + j];
    cut_y -= axes[3 + j] * s.axes[6 + j];
  }
  const double u = camera.focal_x * x_grad + (s.cut[0] == s.slope[0] ? cut_x : 0);
  const double v = camera.focal_y * y_grad + (s.cut[1] == s.slope[1] ? cut_y : 0);
  const double in_cam[3] = {
      u * inverse_z, v * inverse_z,
      g[9] - (focal_x + focal_y + u * s.slope[0] + v * s.slope[1]) * inverse_z};

  const double* R = camera.rotation;
  double turn[9];
  for (int k = 0; k < 3; ++k) {
    double length = 0;
    for (int j = 0; j < 3; ++j) {
      const double t = R[j] * axes[k] + R[3 + j] * axes[3 + k] + R[6 + j] * axes[6 + k];
      turn[3 * j + k] = t * scale[k];
      length += t * s.turn[3 * j + k];
    }
    out.scale[k] += length;
  }
  const double w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  const double q[4] = {
      2 * (x * (turn[7] - turn[5]) + y * (turn[2] - turn[6]) + z * (turn[3] - turn[1])),
      2 * (-2 * x * (turn[4] + turn[8]) + y * (turn[1] + turn[3]) + z * (turn[2] + turn[6]) +
           w * (turn[7] - turn[5])),
      2 * (x * (turn[1] + turn[3]) - 2 * y * (turn[0] + turn[8]) + z * (turn[5] + turn[7]) +
           w * (turn[2] - turn[6])),
      2 * (x * (turn[2] + turn[6]) + y * (turn[5] + turn[7]) - 2 * z * (turn[0] + turn[4]) +
           w * (turn[3] - turn[1]))};
  const double along = q[0] * w + q[1] * x + q[2] * y + q[3] * z;
  for (int k = 0; k < 4; ++k) out.quat[k] += (q[k] - along * s.quat[k]) * s.inverse_norm;

  for (int k = 0; k < 3; ++k) {
    out.mean[k] += R[k] * in_cam[0] + R[3 + k] * in_cam[1] + R[6 + k] * in_cam[2];
  }
  for (int row = 0; row < 3; ++row) {
    for (int k = 0; k < 3; ++k) {
      double t = in_cam[row] * mean[k];
      for (int j = 0; j < 3; ++j) t += axes[3 * row + j] * s.turn[3 * k + j] * scale[j];
      camera_out[4 * row + k] += t;
    }
    camera_out[4 * row + 3] += in_cam[row];
  }

  // Colour.
  float color[3] = {r.red > 0 ? float(g[6]) : 0, r.green > 0 ? float(g[7]) : 0,
                    r.blue > 0 ? float(g[8]) : 0};
  float basis[COUNT], weight[COUNT], direction[3] = {0, 0, 1}, toward[3];
  const float* sh = in.sh + 3 * COUNT * i;
  const double distance = COUNT > 1 ? direction_of(camera, mean, direction) : 1;
  sh_basis<COUNT>(direction[0], direction[1], direction[2], basis);
  for (int k = 0; k < COUNT; ++k) {
    weight[k] = 0;
    for (int ch = 0; ch < 3; ++ch) {
      sh_out[3 * k + ch] += basis[k] * color[ch];
      weight[k] += sh[3 * k + ch] * color[ch];
    }
  }
  if (COUNT == 1) return;
  sh_gradient<COUNT>(direction[0], direction[1], direction[2], weight, toward);
  const double radial = double(toward[0]) * direction[0] + double(toward[1]) * direction[1] +
                        double(toward[2]) * direction[2];
  for (int k = 0; k < 3; ++k) {
    // The vector from the camera is mean + R^T translation.
    const double d = (toward[k] - radial * direction[k]) / distance;
    out.mean[k] += d;
    for (int row = 0; row < 3; ++row) {
      camera_out[4 * row + k] += camera.translation[row] * d;
      camera_out[4 * row + 3] += R[3 * row + k] * d;
    }
  }
}

template <int COUNT>
inline void project_backward_count(const Inputs& in, const Camera* cameras,
                                   const Record* const* records, const Emissions* emissions,
                                   int scene, int begin, int end, const InputGradients& out,
                                   double* camera_out) {
  for (int v = 0; v < in.views; ++v) {
    for (int k = 0; k < 12; ++k) camera_out[12 * v + k] = 0;
  }
  for (int gaussian = begin; gaussian < end; ++gaussian) {
    const std::int64_t i = std::int64_t(scene) * in.gaussians + gaussian;
    Sums total = {};
    float* sh_out = out.sh + 3 * COUNT * i;
    for (int k = 0; k < 3 * COUNT; ++k) sh_out[k] = 0;
    for (int v = 0; v < in.views; ++v) {
      const Emissions& e = emissions[v];
      double g[10] = {};
      bool drawn = false;
      const std::int32_t first = e.first[gaussian], last = first + e.count[gaussian];
      for (std::int32_t k = first; k < last; ++k) {
        if (!e.masks[k]) continue;
        drawn = true;
        const float* from = e.gradients + std::int64_t(GRADIENTS) * k;
        for (int j = 0; j < 10; ++j) g[j] += from[j];
      }
      if (drawn) {
        project_one_backward<COUNT>(in, cameras[v], i, records[v][gaussian], g, total, sh_out,
                                    camera_out + 12 * v);
      }
    }
    for (int k = 0; k < 3; ++k) out.means[3 * i + k] = total.mean[k];
    for (int k = 0; k < 4; ++k) out.quats[4 * i + k] = total.quat[k];
    for (int k = 0; k < 3; ++k) out.scales[3 * i + k] = total.scale[k];
    out.opacities[i] = total.opacity;
  }
}

void project_backward(const Inputs& in, const Camera* cameras, const Record* const* records,
                      const Emissions* emissions, int scene, int begin, int end,
                      const InputGradients& out, double* camera_out) {
  const auto run = [&](auto function) {
    function(in, cameras, records, emissions, scene, begin, end, out, camera_out);
  };
  switch (in.coefficients) {
    case 1: return run(project_backward_count<1>);
    case 4: return run(project_backward_count<4>);
    case 9: return run(project_backward_count<9>);
    default: return run(project_backward_count<16>);
  }
}

}  // namespace
