// Per-anchor features in one tile. The weights of an anchor are those of its Gaussians added up,
// so that features [anchor, channel] need one small matrix product a tile and not one
// accumulation a Gaussian. A quarter is a row of four blocks (64 pixels).

namespace {

constexpr int PLANES_AHEAD = 4;  // channels by which images are fetched early

// Lists the anchors of the tile that touch a quarter.
inline int active_slots(Scratch& s, int slots, int quarter) {
  int count = 0;
  for (int slot = 0; slot < slots; ++slot) {
    s.active[count] = slot;
    count += (s.blocks_of_slot[slot] >> 4 * quarter & 15) != 0;
  }
  return count;
}

// CHANNELS maps from `channel` on: features^T x weights.
template <int CHANNELS>
inline void draw_channels(const Inputs& in, const Tile& tile, const Scratch& s, int active,
                          int quarter, int channel, const Place& place, float* to) {
  Lanes result[CHANNELS][4];
  for (int column = 0; column < 4; column += GEMM_COLUMNS) {
    Lanes sum[CHANNELS][GEMM_COLUMNS];
    for (int j = 0; j < CHANNELS; ++j) {
      for (int c = 0; c < GEMM_COLUMNS; ++c) sum[j][c] = all(0.f);
    }
    for (int k = 0; k < active; ++k) {
      const int slot = s.active[k];
      const float* weights = s.weights + std::int64_t(PIXELS) * slot + 64 * quarter + 16 * column;
      const float* features =
          tile.features + std::int64_t(in.channels) * s.anchor_of_slot[slot] + channel;
      Lanes w[GEMM_COLUMNS];
      for (int c = 0; c < GEMM_COLUMNS; ++c) w[c] = load(weights + 16 * c);
      for (int j = 0; j < CHANNELS; ++j) {
        const Lanes f = all(features[j]);
        for (int c = 0; c < GEMM_COLUMNS; ++c) sum[j][c] = fma(f, w[c], sum[j][c]);
      }
    }
    for (int j = 0; j < CHANNELS; ++j) {
      for (int c = 0; c < GEMM_COLUMNS; ++c) result[j][column + c] = sum[j][c];
    }
  }
  for (int j = 0; j < CHANNELS; ++j) {
    Lanes rows[4];
    swap_blocks_and_rows(result[j], rows);
    put_rows(place, rows, quarter, to + (channel + j) * place.plane);
  }
}

inline void draw_features(const Inputs& in, const Tile& tile, const Scratch& s, int active,
                          int quarter, const Place& place, float* to) {
  int channel = 0;
  for (; channel + GEMM_ROWS <= in.channels; channel += GEMM_ROWS) {
    draw_channels<GEMM_ROWS>(in, tile, s, active, quarter, channel, place, to);
  }
  for (; channel < in.channels; ++channel) {
    draw_channels<1>(in, tile, s, active, quarter, channel, place, to);
  }
}

// Copies dL/d(maps) of the tile, block by block and by pixel, and adds maps . dL/d(maps) to rest.
inline void load_feature_gradients(const Inputs& in, const Place& place, const float* maps,
                                   const float* grads, Scratch& s, float* rest) {
  const int channels = padded(in.channels);
  for (int quarter = 0; quarter < 4; ++quarter) {
    Lanes sum[4] = {all(0.f), all(0.f), all(0.f), all(0.f)}, blocks[4];
    for (int channel = 0; channel < in.channels; ++channel) {
      Lanes grad[4], map[4];
      if (place.whole) {
        const std::int64_t ahead = (channel + PLANES_AHEAD) * place.plane + 4 * quarter * place.row;
        for (int i = 0; i < 4; ++i) {
          __builtin_prefetch(grads + ahead + i * place.row);
          __builtin_prefetch(maps + ahead + i * place.row);
        }
      }
      get_rows(place, grads + channel * place.plane, quarter, grad);
      get_rows(place, maps + channel * place.plane, quarter, map);
      for (int i = 0; i < 4; ++i) sum[i] = fma(grad[i], map[i], sum[i]);
      swap_blocks_and_rows(grad, blocks);
      float* to = s.map_grads + PIXELS * channel + 64 * quarter;
      for (int i = 0; i < 4; ++i) store(to + 16 * i, blocks[i]);
    }
    swap_blocks_and_rows(sum, blocks);
    for (int i = 0; i < 4; ++i) {
      float* to = rest + 64 * quarter + 16 * i;
      store(to, load(to) + blocks[i]);
    }
  }
  for (int i = in.channels * PIXELS; i < channels * PIXELS; i += 16) {
    store(s.map_grads + i, all(0.f));
  }
  for (int channel = 0; channel < channels; channel += 16) {
    for (int pixel = 0; pixel < PIXELS; pixel += 16) {
      transpose(s.map_grads + PIXELS * channel + pixel, PIXELS,
                s.map_grads_by_pixel + std::int64_t(channels) * pixel + channel, channels);
    }
  }
}

// dL/d(weights) of SLOTS anchors in a quarter: features x dL/d(maps).
template <int SLOTS>
inline void weight_gradients_of(const Inputs& in, const Tile& tile, Scratch& s,
                                const std::int32_t* slots, int quarter) {
  const float* features[SLOTS];
  for (int j = 0; j < SLOTS; ++j) {
    features[j] = tile.features + std::int64_t(in.channels) * s.anchor_of_slot[slots[j]];
  }
  for (int column = 0; column < 4; column += GEMM_COLUMNS) {
    const int at = 64 * quarter + 16 * column;
    Lanes sum[SLOTS][GEMM_COLUMNS];
    for (int j = 0; j < SLOTS; ++j) {
      for (int c = 0; c < GEMM_COLUMNS; ++c) sum[j][c] = all(0.f);
    }
    for (int channel = 0; channel < in.channels; ++channel) {
      Lanes grad[GEMM_COLUMNS];
      for (int c = 0; c < GEMM_COLUMNS; ++c) {
        grad[c] = load(s.map_grads + PIXELS * channel + at + 16 * c);
      }
      for (int j = 0; j < SLOTS; ++j) {
        const Lanes f = all(features[j][channel]);
        for (int c = 0; c < GEMM_COLUMNS; ++c) sum[j][c] = fma(f, grad[c], sum[j][c]);
      }
    }
    for (int j = 0; j < SLOTS; ++j) {
      float* to = s.weight_grads + std::int64_t(PIXELS) * slots[j] + at;
      for (int c = 0; c < GEMM_COLUMNS; ++c) store(to + 16 * c, sum[j][c]);
    }
  }
}

inline void weight_gradients(const Inputs& in, const Tile& tile, Scratch& s, int active,
                             int quarter) {
  int k = 0;
  for (; k + GEMM_ROWS <= active; k += GEMM_ROWS) {
    weight_gradients_of<GEMM_ROWS>(in, tile, s, s.active + k, quarter);
  }
  for (; k < active; ++k) weight_gradients_of<1>(in, tile, s, s.active + k, quarter);
}

// Adds weights x dL/d(maps) over the pixels of a quarter, for SLOTS anchors, 16 COLUMNS channels.
template <int SLOTS, int COLUMNS>
inline void feature_gradients_of(const Scratch& s, const std::int32_t* slots, int quarter,
                                 std::int64_t channels, int channel, float* by_slot) {
  Lanes sum[SLOTS][COLUMNS];
  const float* weights[SLOTS];
  for (int j = 0; j < SLOTS; ++j) {
    weights[j] = s.weights + std::int64_t(PIXELS) * slots[j];
    for (int c = 0; c < COLUMNS; ++c) {
      sum[j][c] = load(by_slot + slots[j] * channels + channel + 16 * c);
    }
  }
  for (int pixel = 64 * quarter; pixel < 64 * quarter + 64; ++pixel) {
    const float* grads = s.map_grads_by_pixel + channels * pixel + channel;
    Lanes grad[COLUMNS];
    for (int c = 0; c < COLUMNS; ++c) grad[c] = load(grads + 16 * c);
    for (int j = 0; j < SLOTS; ++j) {
      const Lanes w = all(weights[j][pixel]);
      for (int c = 0; c < COLUMNS; ++c) sum[j][c] = fma(w, grad[c], sum[j][c]);
    }
  }
  for (int j = 0; j < SLOTS; ++j) {
    for (int c = 0; c < COLUMNS; ++c) {
      store(by_slot + slots[j] * channels + channel + 16 * c, sum[j][c]);
    }
  }
}

template <int SLOTS>
inline void feature_gradients_rows(const Scratch& s, const std::int32_t* slots, int quarter,
                                   int channels, float* by_slot) {
  int channel = 0;
  for (; channel + 16 * GEMM_COLUMNS <= channels; channel += 16 * GEMM_COLUMNS) {
    feature_gradients_of<SLOTS, GEMM_COLUMNS>(s, slots, quarter, channels, channel, by_slot);
  }
  if (GEMM_COLUMNS > 3 && channel + 48 <= channels) {
    feature_gradients_of<SLOTS, 3>(s, slots, quarter, channels, channel, by_slot);
    channel += 48;
  }
  for (; channel < channels; channel += 16) {
    feature_gradients_of<SLOTS, 1>(s, slots, quarter, channels, channel, by_slot);
  }
}

inline void feature_gradients(const Inputs& in, const Scratch& s, int active, int quarter,
                              float* by_slot) {
  const int channels = padded(in.channels);
  int k = 0;
  for (; k + GEMM_ROWS <= active; k += GEMM_ROWS) {
    feature_gradients_rows<GEMM_ROWS>(s, s.active + k, quarter, channels, by_slot);
  }
  for (; k < active; ++k) {
    feature_gradients_rows<1>(s, s.active + k, quarter, channels, by_slot);
  }
}

}  // namespace
