#include "rasterizer.hpp"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <stdexcept>

#include "team.hpp"

namespace instok3d {
namespace {

constexpr int CHUNK = 1024;         // Gaussians in a task
constexpr int CHANNEL_SLICE = 32;   // channels in a task that adds up feature gradients

int divided_up(int count, int size) { return (count + size - 1) / size; }

Camera camera_of(const Inputs& in, int picture) {
  const float* m = in.cam_from_world + 16 * std::int64_t(picture);
  const float* k = in.intrinsics + 9 * std::int64_t(picture);
  Camera c;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) c.rotation[3 * row + column] = m[4 * row + column];
    c.translation[row] = m[4 * row + 3];
  }
  for (int i = 0; i < 3; ++i) {
    c.position[i] = 0;
    for (int j = 0; j < 3; ++j) c.position[i] -= c.rotation[3 * j + i] * c.translation[j];
  }
  c.focal_x = k[0], c.focal_y = k[4], c.center_x = k[2], c.center_y = k[5];
  const double margin_x = 0.15 * in.width / c.focal_x, margin_y = 0.15 * in.height / c.focal_y;
  c.lowest_x = -c.center_x / c.focal_x - margin_x;
  c.highest_x = (in.width - c.center_x) / c.focal_x + margin_x;
  c.lowest_y = -c.center_y / c.focal_y - margin_y;
  c.highest_y = (in.height - c.center_y) / c.focal_y + margin_y;
  return c;
}

template <class Pointers>
Pointers images_of(const Inputs& in, const Pointers& all, int picture) {
  const std::int64_t plane = std::int64_t(in.height) * in.width;
  const auto at = [&](auto* base, int channels) {
    return base ? base + plane * channels * picture : base;
  };
  return {at(all.colors, 3), at(all.alphas, 1), at(all.depths, 1), at(all.features, in.channels)};
}

Tile tile_of(const Inputs& in, const Frame& frame, int picture, int tile) {
  const Bins& bins = frame.pictures[picture];
  const std::int64_t features = std::int64_t(in.anchors) * in.channels * (picture / in.views);
  return {bins.records(), bins.entries() + bins.entries_begin(tile),
          bins.entries() + bins.entries_begin(tile + 1), bins.masks(), in.features + features,
          tile % in.tiles_x() * TILE, tile / in.tiles_x() * TILE};
}

// Scratch memory of one thread.
class Workspace {
 public:
  Workspace(const Inputs& in, int slots, bool backward)
      : ints_(sizeof(std::int32_t) * (2 * std::size_t(in.anchors) + 3 * std::size_t(slots))),
        weights_(sizeof(float) * PIXELS * std::size_t(slots) * (backward ? 2 : 1)),
        maps_(backward ? sizeof(float) * PIXELS * std::size_t(2 * padded(in.channels)) : 0) {
    auto* ints = ints_.as<std::int32_t>();
    std::memset(ints, 0, sizeof(std::int32_t) * in.anchors);
    scratch.generation = 0;
    scratch.stamp = ints;
    scratch.slot_of_anchor = ints + in.anchors;
    scratch.anchor_of_slot = ints + 2 * std::size_t(in.anchors);
    scratch.active = scratch.anchor_of_slot + slots;
    scratch.blocks_of_slot = reinterpret_cast<std::uint16_t*>(scratch.active + slots);
    scratch.weights = weights_.as<float>();
    scratch.weight_grads = scratch.weights + PIXELS * std::size_t(slots);
    scratch.map_grads = maps_.as<float>();
    scratch.map_grads_by_pixel = scratch.map_grads + PIXELS * std::size_t(padded(in.channels));
  }
  Scratch scratch;

 private:
  Buffer ints_, weights_, maps_;
};

std::vector<Workspace> workspaces(const Inputs& in, const Frame& frame, int threads,
                                  bool backward) {
  int slots = 1;  // `active` is written one beyond the last, too
  if (in.channels) {
    for (const Bins& bins : frame.pictures) {
      slots = std::max(slots, 1 + std::min(in.anchors, bins.longest_list()));
    }
  }
  std::vector<Workspace> result;
  for (int i = 0; i < threads; ++i) result.emplace_back(in, slots, backward);
  return result;
}

void require_anchors(bool exist) {
  if (!exist) throw std::out_of_range("anchor_index has a number without a row of anchor_features");
}

}  // namespace

std::unique_ptr<Frame> draw_all(const Inputs& in, const Kernels& kernels, const Images& images,
                                int wanted_threads) {
  const int threads = usable_threads(wanted_threads);
  const int pictures = in.pictures();
  const std::int64_t tiles = in.tiles(), parts = divided_up(in.gaussians, CHUNK);
  auto frame = std::make_unique<Frame>(in);
  for (int picture = 0; picture < pictures; ++picture) {
    frame->cameras.push_back(camera_of(in, picture));
    frame->pictures.emplace_back(in.gaussians, in.height, in.width);
  }
  frame->slots.resize(std::size_t(pictures) * tiles);
  std::atomic<bool> anchors_exist{true};
  const auto project = [&](int picture, int begin, int end) {
    if (!kernels.project(in, frame->cameras[picture], picture / in.views, begin, end,
                         frame->pictures[picture].records())) {
      anchors_exist = false;
    }
  };

  std::vector<Stage> stages;
  if (threads == 1 || pictures >= 2 * threads) {  // whole pictures in parallel
    stages.push_back({[&] { return pictures; }, [&](std::int64_t picture, int) {
                        Bins& bins = frame->pictures[picture];
                        project(static_cast<int>(picture), 0, in.gaussians);
                        bins.sort();
                        bins.split(1);
                        bins.count(0, 1);
                        bins.scan(1);
                        bins.place(0, 1);
                      }});
  } else {
    stages.push_back({[&] { return pictures * parts; }, [&](std::int64_t task, int) {
                        const int begin = static_cast<int>(task % parts) * CHUNK;
                        project(static_cast<int>(task / parts), begin,
                                std::min(begin + CHUNK, in.gaussians));
                      }});
    stages.push_back({[&] { return pictures; }, [&](std::int64_t picture, int) {
                        frame->pictures[picture].sort();
                        frame->pictures[picture].split(parts);
                      }});
    stages.push_back({[&] { return pictures * parts; }, [&](std::int64_t task, int) {
                        frame->pictures[task / parts].count(static_cast<int>(task % parts), parts);
                      }});
    stages.push_back({[&] {
                        for (Bins& bins : frame->pictures) bins.scan(parts);
                        return pictures * parts;
                      },
                      [&](std::int64_t task, int) {
                        frame->pictures[task / parts].place(static_cast<int>(task % parts), parts);
                      }});
  }
  std::vector<Workspace> memory;
  stages.push_back({[&] {
                      require_anchors(anchors_exist);
                      memory = workspaces(in, *frame, threads, false);
                      return pictures * tiles;
                    },
                    [&](std::int64_t task, int thread) {
                      const int picture = static_cast<int>(task / tiles);
                      const int index = static_cast<int>(task % tiles);
                      const Tile tile = tile_of(in, *frame, picture, index);
                      frame->slots[task] = kernels.draw(in, tile, memory[thread].scratch,
                                                        images_of(in, images, picture));
                    }});
  run_stages(threads, stages);
  return frame;
}

namespace {

// Feature gradients of every (tile, anchor) of all pictures.
struct AnchorRows {
  std::vector<std::int64_t> begin;  // by picture and tile
  Buffer grads, anchors;
  std::int64_t channels;

  AnchorRows(const Inputs& in, const Frame& frame) : channels(padded(in.channels)) {
    std::int64_t total = 0;
    for (const std::int32_t slots : frame.slots) {
      begin.push_back(total);
      total += slots;
    }
    begin.push_back(total);
    grads = Buffer(sizeof(float) * total * channels);
    anchors = Buffer(sizeof(std::int32_t) * total);
  }
};

// One slice of channels of one scene: adds up the rows in order.
void sum_rows(const Inputs& in, const AnchorRows& rows, int scene, int first_channel, float* out) {
  const int count = std::min(CHANNEL_SLICE, in.channels - first_channel);
  const std::int64_t tiles = std::int64_t(in.tiles()) * in.views;
  out += std::int64_t(scene) * in.anchors * in.channels + first_channel;
  for (int anchor = 0; anchor < in.anchors; ++anchor) {
    std::memset(out + std::int64_t(anchor) * in.channels, 0, sizeof(float) * count);
  }
  const std::int64_t begin = rows.begin[scene * tiles];
  const std::int64_t end = rows.begin[(scene + 1) * tiles];
  for (std::int64_t row = begin; row < end; ++row) {
    float* to = out + std::int64_t(rows.anchors.as<std::int32_t>()[row]) * in.channels;
    const float* from = rows.grads.as<float>() + row * rows.channels + first_channel;
    for (int c = 0; c < count; ++c) to[c] += from[c];
  }
}

}  // namespace

void draw_all_backward(const Inputs& in, const Kernels& kernels, const Frame& frame,
                       const ConstImages& images, const ConstImages& grads, const Gradients& out,
                       int wanted_threads) {
  const int threads = usable_threads(wanted_threads);
  const int pictures = in.pictures();
  const std::int64_t tiles = in.tiles(), parts = divided_up(in.gaussians, CHUNK);
  const std::int64_t slices = divided_up(in.channels, CHANNEL_SLICE);
  std::vector<Buffer> pairs;
  std::vector<Workspace> memory;
  std::unique_ptr<AnchorRows> rows;
  std::vector<const Record*> records;
  std::vector<Emissions> emissions;
  const Buffer camera_sums(sizeof(double) * 12 * in.views * std::size_t(in.scenes) * parts);

  const Stage draw = {
      [&] {
        for (const Bins& bins : frame.pictures) {
          pairs.emplace_back(sizeof(float) * GRADIENTS * std::size_t(bins.entry_count()));
          records.push_back(bins.records());
          emissions.push_back({bins.first_emission(), bins.emission_count(), bins.masks(),
                               pairs.back().as<float>()});
        }
        memory = workspaces(in, frame, threads, true);
        if (grads.features) rows = std::make_unique<AnchorRows>(in, frame);
        return pictures * tiles;
      },
      [&](std::int64_t task, int thread) {
        const int picture = static_cast<int>(task / tiles);
        PairGradients to = {pairs[picture].as<float>(), nullptr, nullptr};
        if (rows) {
          to.by_slot = rows->grads.as<float>() + rows->begin[task] * rows->channels;
          to.anchor_of_slot = rows->anchors.as<std::int32_t>() + rows->begin[task];
        }
        kernels.draw_backward(in, tile_of(in, frame, picture, static_cast<int>(task % tiles)),
                              memory[thread].scratch, images_of(in, images, picture),
                              images_of(in, grads, picture), to);
      }};
  const Stage gather = {
      [&] { return in.scenes * (parts + (rows ? slices : 0)); },
      [&](std::int64_t task, int) {
        if (task >= in.scenes * parts) {
          const std::int64_t slice = task - in.scenes * parts;
          return sum_rows(in, *rows, static_cast<int>(slice / slices),
                          static_cast<int>(slice % slices) * CHANNEL_SLICE, out.features);
        }
        const int scene = static_cast<int>(task / parts);
        const int begin = static_cast<int>(task % parts) * CHUNK;
        const int first = scene * in.views;
        kernels.project_backward(in, frame.cameras.data() + first, records.data() + first,
                                 emissions.data() + first, scene, begin,
                                 std::min(begin + CHUNK, in.gaussians), out.gaussians,
                                 camera_sums.as<double>() + std::int64_t(12) * in.views * task);
      }};
  run_stages(threads, {draw, gather});

  for (int picture = 0; picture < pictures; ++picture) {
    const int scene = picture / in.views, view = picture % in.views;
    float* to = out.cam_from_world + 16 * std::int64_t(picture);
    double sums[12] = {};
    for (int part = 0; part < parts; ++part) {
      const double* from = camera_sums.as<double>() +
                           12 * ((scene * parts + part) * in.views + view);
      for (int k = 0; k < 12; ++k) sums[k] += from[k];
    }
    for (int k = 0; k < 16; ++k) to[k] = k < 12 ? static_cast<float>(sums[k]) : 0;
  }
}

}  // namespace instok3d
