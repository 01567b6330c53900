// What the kernels, compiled once for each instruction set, share with the code around them.
#pragma once

#include <cstdint>

namespace instok3d {

constexpr int TILE = 16;         // pixels along the side of a tile
constexpr int PIXELS = 256;      // in a tile; stored as 16 blocks of 4x4 pixels
constexpr int GRADIENTS = 12;    // floats a (tile, Gaussian) pair sends back; 10 are used

// Lengths of the axes of all inputs and images; anchors and channels are 0 without features.
struct Sizes {
  int scenes, views, gaussians, coefficients, anchors, channels, height, width;

  bool operator==(const Sizes& o) const {
    return scenes == o.scenes && views == o.views && gaussians == o.gaussians &&
           coefficients == o.coefficients && anchors == o.anchors && channels == o.channels &&
           height == o.height && width == o.width;
  }
  int tiles_x() const { return (width + TILE - 1) / TILE; }
  int tiles_y() const { return (height + TILE - 1) / TILE; }
  int tiles() const { return tiles_x() * tiles_y(); }
  int pictures() const { return scenes * views; }
};

// The arguments of a call. Arrays are contiguous; the leading axis is the scene.
struct Inputs : Sizes {
  const float *means, *quats, *scales, *opacities, *sh, *cam_from_world, *intrinsics, *features;
  const std::int64_t* anchor_index;
  double near, far, eps2d, alpha_min, alpha_max, transmittance_min;
  float background[3];
};

// One projected Gaussian, a cache line. The log2 of its alpha at mean - (dx, dy) is
// xx dx^2 + xy dx dy + yy dy^2 + log_opacity.
struct Record {
  float x, y, xx, xy, yy, log_opacity;
  float x_per_y, y_per_x;    // ridges of the ellipse: x is extreme along y_per_x, and so on
  float red, green, blue, depth;
  float extent_x, extent_y;  // half sizes of the box around {alpha >= alpha_min}
  float reach;               // squared Mahalanobis distance of its border; < 0: culled
  std::int32_t anchor;
};
static_assert(sizeof(Record) == 64, "a record is a cache line");

// A Gaussian in the list of a tile. Emissions number the pairs of a picture by Gaussian.
struct Entry {
  std::int32_t gaussian, emission;
};

// One camera, and what every Gaussian needs of it.
struct Camera {
  double rotation[9], translation[3], position[3], focal_x, focal_y, center_x, center_y;
  double lowest_x, highest_x, lowest_y, highest_y;  // slopes x/z, y/z at which the Jacobian stops
};

// Images of one picture.
struct Images {
  float *colors, *alphas, *depths, *features;
};
struct ConstImages {
  const float *colors, *alphas, *depths, *features;
};

// Memory of one thread, enough for `slots` anchors in a tile.
struct Scratch {
  std::int32_t *stamp, *slot_of_anchor;        // one for each anchor
  std::int32_t generation;
  std::int32_t *anchor_of_slot, *active;       // one for each slot
  std::uint16_t* blocks_of_slot;               // blocks of the tile that the anchor touches
  float *weights, *weight_grads;               // slots x 256
  float *map_grads, *map_grads_by_pixel;       // padded channels x 256, and transposed
};

// One tile of one picture.
struct Tile {
  const Record* records;
  const Entry *begin, *end;
  std::uint16_t* masks;      // by emission: blocks of the tile that the Gaussian was drawn in
  const float* features;     // of the scene: anchors x channels
  int x, y;                  // of the first pixel
};

struct PairGradients {
  float* by_emission;        // GRADIENTS floats each
  float* by_slot;            // padded channels each, of this tile; or null
  std::int32_t* anchor_of_slot;
};

// Sums over the pictures' gradients of one Gaussian, or of the inputs.
struct InputGradients {
  float *means, *quats, *scales, *opacities, *sh;
};

// Emissions of every Gaussian of one picture.
struct Emissions {
  const std::int32_t *first, *count;  // by Gaussian
  const std::uint16_t* masks;
  const float* gradients;
};

struct Kernels {
  const char* name;
  // Projects Gaussians [begin, end) of a scene. Returns false if an anchor index is out of range.
  bool (*project)(const Inputs&, const Camera&, int scene, int begin, int end, Record*);
  // Fills the tile in the images; returns the number of anchors that touch it.
  int (*draw)(const Inputs&, const Tile&, Scratch&, const Images&);
  // Gradients of every pair of the tile.
  void (*draw_backward)(const Inputs&, const Tile&, Scratch&, const ConstImages& images,
                        const ConstImages& grads, const PairGradients&);
  // Adds gradients of Gaussians [begin, end) of a scene, summed over its views in order, and
  // writes those of cam_from_world (rows of 3x4, one for each view) that they cause.
  void (*project_backward)(const Inputs&, const Camera*, const Record* const*, const Emissions*,
                           int scene, int begin, int end, const InputGradients&, double* cameras);
};

extern const Kernels portable_kernels;
#ifdef INSTOK3D_X86
extern const Kernels avx2_kernels;
extern const Kernels avx512_kernels;
#endif

inline int padded(int channels) { return (channels + 15) / 16 * 16; }

}  // namespace instok3d
