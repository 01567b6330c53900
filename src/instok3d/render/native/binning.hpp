// Which Gaussians each tile of a picture shows, front to back.
#pragma once

#include <cstdint>
#include <vector>

#include "buffer.hpp"
#include "kernels.hpp"

namespace instok3d {

// The lists of one picture. The steps run in the order in which they stand here; `count` and
// `place` once for each of `chunks` parts of the depth order, in any order of the parts. The
// lists do not depend on the number of chunks.
class Bins {
 public:
  Bins(int gaussians, int height, int width);

  Record* records() { return records_.as<Record>(); }
  const Record* records() const { return records_.as<Record>(); }

  void sort();
  void split(int chunks) { chunks_.resize(chunks); }
  void count(int chunk, int chunks);
  void scan(int chunks);
  void place(int chunk, int chunks);

  std::int32_t entries_begin(int tile) const { return tile_begin_.as<std::int32_t>()[tile]; }
  const Entry* entries() const { return entries_.as<Entry>(); }
  std::int32_t entry_count() const { return entries_begin(tiles_); }
  int longest_list() const;
  std::uint16_t* masks() const { return masks_.as<std::uint16_t>(); }
  const std::int32_t* first_emission() const { return first_.as<std::int32_t>(); }
  const std::int32_t* emission_count() const { return count_.as<std::int32_t>(); }

 private:
  struct Chunk {
    std::vector<std::int32_t> tiles;   // of its emissions, in order
    std::vector<std::int32_t> totals;  // entries in each tile, then where the next one goes
  };

  int gaussians_, height_, width_, tiles_x_, tiles_, visible_ = 0;
  Buffer records_, order_, first_, count_, tile_begin_, entries_, masks_;
  std::vector<Chunk> chunks_;
};

constexpr int PADDING = 16;  // entries after the last list that may be looked at, all 0

}  // namespace instok3d
