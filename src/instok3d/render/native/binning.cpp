#include "binning.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

namespace instok3d {
namespace {

constexpr float LOG2E = 1.4426950408889634f;

// Stable radix sort of `order` by `keys`, 11 bits at a time. All arrays hold n; the sorted order
// is in `order`, the keys are used up.
void sort_by_key(int n, std::uint32_t* keys, std::int32_t* order, std::uint32_t* other_keys,
                 std::int32_t* other_order) {
  std::uint32_t starts[3][2048] = {};
  for (int i = 0; i < n; ++i) {
    for (int pass = 0; pass < 3; ++pass) ++starts[pass][keys[i] >> 11 * pass & 2047];
  }
  for (auto& start : starts) {
    std::uint32_t sum = 0;
    for (std::uint32_t& s : start) sum += std::exchange(s, sum);
  }
  for (int pass = 0; pass < 3; ++pass) {
    for (int i = 0; i < n; ++i) {
      const std::uint32_t to = starts[pass][keys[i] >> 11 * pass & 2047]++;
      other_keys[to] = keys[i];
      other_order[to] = order[i];
    }
    std::swap(keys, other_keys);
    std::swap(order, other_order);
  }
  std::memcpy(other_order, order, n * sizeof *order);  // three passes end in the other array
}

// Rounding by hand: without SSE 4.1, ceil and floor are calls. An edge that is NaN is that of the
// image, in these orders of the arguments.
int first_pixel(float edge, int size) {
  const float at = std::min(std::max(0.f, edge - 0.5f), float(size));
  const int below = static_cast<int>(at);
  return below + (float(below) < at);
}
int last_pixel(float edge, int size) {
  return static_cast<int>(std::max(std::min(float(size), edge + 0.5f), 0.f)) - 1;
}

// The pixels around an ellipse.
struct Box {
  int x0, x1, y0, y1;  // pixels, both ends included
  bool empty() const { return x0 > x1 || y0 > y1; }
  int tiles() const {
    return empty() ? 0 : (x1 / TILE - x0 / TILE + 1) * (y1 / TILE - y0 / TILE + 1);
  }
};

// Writes the tiles whose pixel centres the ellipse {alpha >= alpha_min} can reach, counts them in
// `totals`, and returns the end. There must be room for all tiles of the box.
std::int32_t* write_tiles(const Record& r, const Box& box, int width, int tiles_x,
                          std::int32_t* totals, std::int32_t* to) {
  const auto write = [&](int row, int a, int b) {
    for (int tile = row * tiles_x + a; tile <= row * tiles_x + b; ++tile) {
      ++totals[tile];
      *to++ = tile;
    }
  };
  if (box.tiles() <= 1) {
    if (!box.empty()) write(box.y0 / TILE, box.x0 / TILE, box.x0 / TILE);
    return to;
  }
  const float widest = r.reach / (r.xx * (-2 / LOG2E));  // squared half width at the mean
  const float inverse_extent = 1 / r.extent_y;
  const auto half_width = [&](float dy) {
    const float t = dy * inverse_extent;
    return std::sqrt(std::max(0.f, widest * (1 - t * t)));
  };
  const float dy_rightmost = r.y_per_x * r.extent_x;
  for (int row = box.y0 / TILE; row <= box.y1 / TILE; ++row) {
    const float low = std::max(row * TILE + 0.5f - r.y, -r.extent_y);
    const float high = std::min(row * TILE + TILE - 0.5f - r.y, r.extent_y);
    if (low > high) continue;
    const float low_center = r.x_per_y * low, high_center = r.x_per_y * high;
    const float low_half = half_width(low), high_half = half_width(high);
    const float right = dy_rightmost >= low && dy_rightmost <= high
                            ? r.extent_x
                            : std::max(low_center + low_half, high_center + high_half);
    const float left = -dy_rightmost >= low && -dy_rightmost <= high
                           ? -r.extent_x
                           : std::min(low_center - low_half, high_center - high_half);
    const int a = std::max(box.x0, first_pixel(r.x + left - 1e-2f, width));
    const int b = std::min(box.x1, last_pixel(r.x + right + 1e-2f, width));
    if (a <= b) write(row, a / TILE, b / TILE);
  }
  return to;
}

}  // namespace

Bins::Bins(int gaussians, int height, int width)
    : gaussians_(gaussians), height_(height), width_(width),
      tiles_x_((width + TILE - 1) / TILE), tiles_(tiles_x_ * ((height + TILE - 1) / TILE)),
      records_(sizeof(Record) * gaussians), order_(sizeof(std::int32_t) * gaussians),
      first_(sizeof(std::int32_t) * gaussians), count_(sizeof(std::int32_t) * gaussians),
      tile_begin_(sizeof(std::int32_t) * (tiles_ + 1)) {}

void Bins::sort() {
  const std::size_t bytes = sizeof(std::int32_t) * gaussians_;
  const Buffer keys(bytes), other_keys(bytes), other_order(bytes);
  auto* key = keys.as<std::uint32_t>();
  auto* order = order_.as<std::int32_t>();
  std::memset(count_.as<void>(), 0, bytes);
  visible_ = 0;
  for (int g = 0; g < gaussians_; ++g) {
    const Record& r = records()[g];
    if (r.reach < 0) continue;
    std::memcpy(key + visible_, &r.depth, sizeof r.depth);  // positive floats sort as integers
    order[visible_++] = g;
  }
  sort_by_key(visible_, key, order, other_keys.as<std::uint32_t>(),
              other_order.as<std::int32_t>());
}

void Bins::count(int chunk, int chunks) {
  Chunk& c = chunks_[chunk];
  const int begin = std::int64_t(visible_) * chunk / chunks;
  const int end = std::int64_t(visible_) * (chunk + 1) / chunks;
  std::size_t written = 0;
  c.tiles.resize(std::max(c.tiles.size(), std::size_t(end - begin) * 8));
  c.totals.assign(tiles_, 0);
  for (int rank = begin; rank < end; ++rank) {
    const int g = order_.as<std::int32_t>()[rank];
    const Record& r = records()[g];
    const Box box = {first_pixel(r.x - r.extent_x, width_), last_pixel(r.x + r.extent_x, width_),
                     first_pixel(r.y - r.extent_y, height_),
                     last_pixel(r.y + r.extent_y, height_)};
    if (written + box.tiles() > c.tiles.size()) c.tiles.resize(2 * (written + box.tiles()));
    std::int32_t* from = c.tiles.data() + written;
    const std::int32_t* end_of_g =
        write_tiles(r, box, width_, tiles_x_, c.totals.data(), from);
    count_.as<std::int32_t>()[g] = static_cast<std::int32_t>(end_of_g - from);
    written += end_of_g - from;
  }
}

void Bins::scan(int chunks) {
  std::int64_t total = 0;
  for (int g = 0; g < gaussians_; ++g) total += emission_count()[g];
  if (total > INT32_MAX - PADDING) {
    throw std::length_error("more than 2^31 pairs of a Gaussian and a tile in one picture; render "
                            "fewer or smaller Gaussians, or a smaller picture");
  }
  std::int32_t emission = 0;
  for (int g = 0; g < gaussians_; ++g) {
    first_.as<std::int32_t>()[g] = emission;
    emission += emission_count()[g];
  }
  std::int32_t at = 0;
  for (int tile = 0; tile < tiles_; ++tile) {
    tile_begin_.as<std::int32_t>()[tile] = at;
    for (int chunk = 0; chunk < chunks; ++chunk) {
      at += std::exchange(chunks_[chunk].totals[tile], at);
    }
  }
  tile_begin_.as<std::int32_t>()[tiles_] = at;
  entries_ = Buffer(sizeof(Entry) * (std::size_t(at) + PADDING));
  std::memset(entries_.as<Entry>() + at, 0, sizeof(Entry) * PADDING);
  masks_ = Buffer(sizeof(std::uint16_t) * std::size_t(at));
  std::memset(masks_.as<void>(), 0, sizeof(std::uint16_t) * std::size_t(at));
}

void Bins::place(int chunk, int chunks) {
  Chunk& c = chunks_[chunk];
  const int begin = std::int64_t(visible_) * chunk / chunks;
  const int end = std::int64_t(visible_) * (chunk + 1) / chunks;
  const std::int32_t* tile = c.tiles.data();
  for (int rank = begin; rank < end; ++rank) {
    const int g = order_.as<std::int32_t>()[rank];
    const std::int32_t first = first_emission()[g], last = first + emission_count()[g];
    for (std::int32_t emission = first; emission < last; ++emission) {
      entries_.as<Entry>()[c.totals[*tile++]++] = {g, emission};
    }
  }
}

int Bins::longest_list() const {
  int longest = 0;
  for (int tile = 0; tile < tiles_; ++tile) {
    longest = std::max(longest, entries_begin(tile + 1) - entries_begin(tile));
  }
  return longest;
}

}  // namespace instok3d
