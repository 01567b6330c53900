// Patches of one photo found again in another, as `search_reference` of alignment.py defines it.
#pragma once

namespace instok3d {

constexpr int PATCH = 8;

struct AlignmentInputs {
  int scenes, cells;
  int height, width;              // of the photos searched in
  int own_height, own_width;      // of the photos of the patches
  const float* own_photos;        // [scene 3 own_height own_width]
  const float* photos;            // [scene 3 height width]
  const float* centers;           // [cell 2], pixels
  const float* depths;            // [scene cell], of the surfaces of the patches
  const float* peaks;             // [scene cell 2], pixels, where the descriptors see the match
  const float* confidence;        // [scene cell], of the matches
  const float* warps;             // [scene 3 3], pixels there from pixels here at depth 1 ...
  const float* shifts;            // [scene 3], ... and what the way between the cameras adds
  const float* window;            // [PATCH PATCH], weights of a patch's pixels
  float nearest;                  // depth at which a point counts as behind a camera
  float largest_warp, start_reach, peak_reach, nearest_error;  // pixels
  float color_noise, shared;
  float least_confidence;         // cells up to this are left out
  int iterations;
};

// Those of cells that are left out stay as they are.
struct AlignmentOutputs {
  float* pixels;     // [scene cell 2]
  float* precision;  // [scene cell 2 2]
};

void align(const AlignmentInputs& in, const AlignmentOutputs& out, int threads);

}  // namespace instok3d
