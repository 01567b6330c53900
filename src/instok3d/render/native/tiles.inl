// Drawing of one tile and its gradients. Sixteen lanes are a block of 4x4 pixels; within a tile,
// block b starts at pixel (4 (b % 4), 4 (b / 4)), and images of the tile are stored block by block.

namespace {

constexpr int AHEAD = 6;  // entries by which records are fetched early

// Per-lane constants.
struct Grid {
  Lanes block_x, block_y;            // lane = block: its first pixel
  Lanes x, y, xx, xy, yy;            // lane = pixel of a block: offset from the first, products
  Grid() {
    alignas(64) float a[16], b[16], c[16], d[16];
    for (int i = 0; i < 16; ++i) {
      a[i] = float(i % 4 * 4), b[i] = float(i / 4 * 4), c[i] = float(i % 4), d[i] = float(i / 4);
    }
    block_x = load(a), block_y = load(b), x = load(c), y = load(d);
    xx = x * x, xy = x * y, yy = y * y;
  }
};

// The exponent of a Gaussian at the first pixel of each block, its linear terms there (the pixel
// at offset (x, y) has value - slope_x x - slope_y y + quadratic), and mean - first pixel.
struct Blocks {
  alignas(64) float value[16], slope_x[16], slope_y[16], dx[16], dy[16];
};

template <bool OFFSETS>
inline void expand(const Record& r, Lanes dx, Lanes dy, Blocks& out) {
  const Lanes xx = all(r.xx), xy = all(r.xy), yy = all(r.yy);
  const Lanes t = fma(xy, dy, xx * dx);
  store(out.value, fma(t, dx, fma(yy * dy, dy, all(r.log_opacity))));
  store(out.slope_x, fma(xx, dx, t));
  store(out.slope_y, fma(yy + yy, dy, xy * dx));
  if (OFFSETS) {
    store(out.dx, dx);
    store(out.dy, dy);
  }
}

// Blocks where the exponent reaches the threshold somewhere: the ellipse against each block's
// square. The best point of a square is on the edges that face the mean; on each it is where the
// ridge of the ellipse crosses, or the nearer end.
inline std::uint32_t reached(const Record& r, Lanes dx, Lanes dy, float threshold) {
  const Lanes zero = all(0.f), three = all(3.f);
  const Lanes xx = all(r.xx), xy = all(r.xy), yy = all(r.yy);
  const Lanes nx = dx - smaller(larger(dx, zero), three);
  const Lanes ny = dy - smaller(larger(dy, zero), three);
  const Lanes by = larger(smaller(all(r.y_per_x) * nx, dy), dy - three);
  const Lanes bx = larger(smaller(all(r.x_per_y) * ny, dx), dx - three);
  const Lanes e1 = fma(fma(xy, by, xx * nx), nx, yy * by * by);
  const Lanes e2 = fma(fma(xy, ny, xx * bx), bx, yy * ny * ny);
  return bits(at_least(larger(e1, e2), all(threshold - r.log_opacity - 1e-3f)));
}

// Transmittance at the start: 1, or -1 (a pixel that has ended) outside of the image. Returns the
// blocks with a pixel inside.
inline std::uint32_t start_transmittance(const Inputs& in, const Tile& tile, float* transmittance) {
  const int columns = in.width - tile.x, rows = in.height - tile.y;
  if (columns >= TILE && rows >= TILE) {
    for (int b = 0; b < 16; ++b) store(transmittance + 16 * b, all(1.f));
    return 0xffff;
  }
  std::uint32_t alive = 0;
  for (int i = 0; i < PIXELS; ++i) {
    const int b = i / 16, x = b % 4 * 4 + i % 4, y = b / 4 * 4 + i % 16 / 4;
    const bool inside = x < columns && y < rows;
    transmittance[i] = inside ? 1.f : -1.f;
    if (inside) alive |= 1u << b;
  }
  return alive;
}

// Number of the anchor among those of this tile; a new one starts with weights 0.
inline int slot_of(Scratch& s, int anchor, int& slots, bool clear) {
  if (s.stamp[anchor] != s.generation) {
    s.stamp[anchor] = s.generation;
    s.slot_of_anchor[anchor] = slots;
    s.anchor_of_slot[slots] = anchor;
    s.blocks_of_slot[slots] = 0;
    if (clear) {
      float* weights = s.weights + std::int64_t(PIXELS) * slots;
      for (int b = 0; b < 16; ++b) store(weights + 16 * b, all(0.f));
    }
    ++slots;
  }
  return s.slot_of_anchor[anchor];
}

struct Limits {
  float threshold, highest, stop;  // log2 alpha_min, log2 alpha_max, transmittance_min
  explicit Limits(const Inputs& in)
      : threshold(float(std::log2(in.alpha_min))), highest(float(std::log2(in.alpha_max))),
        stop(float(in.transmittance_min)) {}
};

// Front to back over the list of the tile. A pixel that has ended keeps its transmittance with a
// minus sign, which no later Gaussian can get above `stop`. `sums`: red, green, blue, w z.
template <bool FEATURES>
int sweep(const Inputs& in, const Tile& tile, Scratch& s, float* transmittance, float* sums) {
  const Grid grid;
  const Limits limits(in);
  const Lanes threshold = all(limits.threshold), stop = all(limits.stop), zero = all(0.f);
  const float origin_x = tile.x + 0.5f, origin_y = tile.y + 0.5f;
  std::uint32_t alive = start_transmittance(in, tile, transmittance);
  for (int i = 0; i < 4 * PIXELS; i += 16) store(sums + i, zero);
  int slots = 0;
  Blocks blocks;
  for (const Entry* entry = tile.begin; entry != tile.end && alive; ++entry) {
    __builtin_prefetch(tile.records + entry[AHEAD].gaussian);
    const Record& r = tile.records[entry->gaussian];
    const Lanes dx = all(r.x - origin_x) - grid.block_x, dy = all(r.y - origin_y) - grid.block_y;
    std::uint32_t todo = alive & reached(r, dx, dy, limits.threshold);
    if (!todo) continue;
    tile.masks[entry->emission] = static_cast<std::uint16_t>(todo);
    expand<false>(r, dx, dy, blocks);
    const Lanes quadratic = fma(all(r.xx), grid.xx, fma(all(r.xy), grid.xy, all(r.yy) * grid.yy));
    const Lanes highest = all(r.log_opacity < limits.highest ? r.log_opacity : limits.highest);
    const Lanes red = all(r.red), green = all(r.green), blue = all(r.blue), depth = all(r.depth);
    float* weights = nullptr;
    if (FEATURES) {
      const int slot = slot_of(s, r.anchor, slots, true);
      s.blocks_of_slot[slot] |= static_cast<std::uint16_t>(todo);
      weights = s.weights + std::int64_t(PIXELS) * slot;
    }
    do {
      const int b = __builtin_ctz(todo), at = 16 * b;
      todo &= todo - 1;
      const Lanes e = fnma(grid.x, all(blocks.slope_x[b]),
                           fnma(grid.y, all(blocks.slope_y[b]), quadratic + all(blocks.value[b])));
      const Mask touched = at_least(e, threshold);
      const Lanes alpha = exp2(smaller(e, highest));
      const Lanes before = load(transmittance + at);
      Lanes weight = alpha * before;
      const Lanes after = before - weight;
      const Mask drawn = above_within(touched, after, stop);
      weight = keep(drawn, weight);
      const Lanes now = negative_where(without(touched, drawn), choose(drawn, after, before));
      store(transmittance + at, now);
      if (!any(above(now, zero))) alive &= ~(1u << b);
      store(sums + at, fma(weight, red, load(sums + at)));
      store(sums + PIXELS + at, fma(weight, green, load(sums + PIXELS + at)));
      store(sums + 2 * PIXELS + at, fma(weight, blue, load(sums + 2 * PIXELS + at)));
      store(sums + 3 * PIXELS + at, fma(weight, depth, load(sums + 3 * PIXELS + at)));
      if (FEATURES) store(weights + at, load(weights + at) + weight);
    } while (todo);
  }
  for (int i = 0; i < PIXELS; i += 16) store(transmittance + i, absolute(load(transmittance + i)));
  return slots;
}

int draw(const Inputs& in, const Tile& tile, Scratch& s, const Images& images) {
  alignas(64) float transmittance[PIXELS], sums[4 * PIXELS];
  const Place place(in, tile);
  ++s.generation;
  const int slots = in.channels ? sweep<true>(in, tile, s, transmittance, sums)
                                : sweep<false>(in, tile, s, transmittance, sums);
  const Lanes one = all(1.f), zero = all(0.f);
  for (int i = 0; i < PIXELS; i += 16) {
    const Lanes left = load(transmittance + i), alpha = one - left;
    for (int c = 0; c < 3; ++c) {
      float* color = sums + c * PIXELS + i;
      store(color, fma(left, all(in.background[c]), load(color)));
    }
    float* depth = sums + 3 * PIXELS + i;
    const Mask hit = above(alpha, zero);
    store(depth, keep(hit, load(depth) * reciprocal(choose(hit, alpha, one))));
    store(transmittance + i, alpha);
  }
  for (int c = 0; c < 3; ++c) put_tile(place, sums + c * PIXELS, images.colors + c * place.plane);
  put_tile(place, sums + 3 * PIXELS, images.depths);
  put_tile(place, transmittance, images.alphas);
  if (in.channels) {
    for (int quarter = 0; quarter < 4; ++quarter) {
      const int active = active_slots(s, slots, quarter);
      draw_features(in, tile, s, active, quarter, place, images.features + place.offset);
    }
  }
  finish_streams();
  return slots;
}

// ------------------------------------------------------------------------------------ gradients

// What the backward sweep starts from, block by block.
struct TileGradients {
  alignas(64) float rest[PIXELS];         // sum of later weights times their gradients
  alignas(64) float images[4 * PIXELS];   // dL/d(red, green, blue, sum of w z)
};

// rest = dL/d(image) . image + T dL/dT: what all Gaussians together contribute.
inline void start_gradients(const Place& place, const ConstImages& images,
                            const ConstImages& grads, TileGradients& g) {
  alignas(64) float alpha[PIXELS], other[PIXELS];
  const Lanes zero = all(0.f), one = all(1.f);
  get_tile(place, images.alphas, alpha);
  if (grads.alphas) get_tile(place, grads.alphas, g.rest);
  for (int i = 0; i < PIXELS; i += 16) {
    store(g.rest + i, grads.alphas ? (load(alpha + i) - one) * load(g.rest + i) : zero);
  }
  for (int c = 0; c < 3; ++c) {
    float* color = g.images + c * PIXELS;
    if (grads.colors) {
      get_tile(place, grads.colors + c * place.plane, color);
      get_tile(place, images.colors + c * place.plane, other);
      for (int i = 0; i < PIXELS; i += 16) {
        store(g.rest + i, fma(load(color + i), load(other + i), load(g.rest + i)));
      }
    } else {
      for (int i = 0; i < PIXELS; i += 16) store(color + i, zero);
    }
  }
  if (!grads.depths) return;
  float* depth = g.images + 3 * PIXELS;
  get_tile(place, grads.depths, depth);
  get_tile(place, images.depths, other);
  for (int i = 0; i < PIXELS; i += 16) {
    // depth = D / A: dL/dD = grad / A and, since A = 1 - T, dL/dT = grad depth / A.
    const Lanes a = load(alpha + i), grad = load(depth + i), value = load(other + i);
    const Mask hit = above(a, zero);
    const Lanes by_sum = keep(hit, grad * reciprocal(choose(hit, a, one)));
    store(depth + i, by_sum);
    store(g.rest + i, fma(by_sum, value, load(g.rest + i)));  // value (A + T) by_sum
  }
}

// Front to back again with the same alphas, bit for bit: the gradient to an alpha needs what lies
// behind, and that is `rest` less what has been passed.
template <bool FEATURES, bool DEPTH>
void sweep_backward(const Inputs& in, const Tile& tile, Scratch& s, TileGradients& g,
                    const PairGradients& out) {
  const Grid grid;
  const Limits limits(in);
  const Lanes threshold = all(limits.threshold), stop = all(limits.stop), zero = all(0.f);
  const Lanes one = all(1.f), cut = all(limits.highest);
  const float origin_x = tile.x + 0.5f, origin_y = tile.y + 0.5f;
  alignas(64) float transmittance[PIXELS];
  alignas(64) float dxx[16], dxy[16], dyy[16];
  start_transmittance(in, tile, transmittance);
  Blocks blocks;
  for (const Entry* entry = tile.begin; entry != tile.end; ++entry) {
    std::uint32_t todo = tile.masks[entry->emission];
    __builtin_prefetch(tile.records + entry[AHEAD].gaussian);
    if (!todo) continue;
    const Record& r = tile.records[entry->gaussian];
    const Lanes dx = all(r.x - origin_x) - grid.block_x, dy = all(r.y - origin_y) - grid.block_y;
    expand<true>(r, dx, dy, blocks);
    store(dxx, dx * dx);
    store(dxy, dx * dy);
    store(dyy, dy * dy);
    const Lanes quadratic = fma(all(r.xx), grid.xx, fma(all(r.xy), grid.xy, all(r.yy) * grid.yy));
    const Lanes highest = all(r.log_opacity < limits.highest ? r.log_opacity : limits.highest);
    const Lanes red = all(r.red), green = all(r.green), blue = all(r.blue), depth = all(r.depth);
    float *weights = nullptr, *weight_grads = nullptr;
    if (FEATURES) {
      const std::int64_t at = std::int64_t(PIXELS) * s.slot_of_anchor[r.anchor];
      weights = s.weights + at;
      weight_grads = s.weight_grads + at;
    }
    Lanes m = zero, mx = zero, my = zero, mxx = zero, mxy = zero, myy = zero;
    Lanes to_red = zero, to_green = zero, to_blue = zero, to_depth = zero;
    do {
      const int b = __builtin_ctz(todo), at = 16 * b;
      todo &= todo - 1;
      const Lanes e = fnma(grid.x, all(blocks.slope_x[b]),
                           fnma(grid.y, all(blocks.slope_y[b]), quadratic + all(blocks.value[b])));
      const Mask touched = at_least(e, threshold);
      const Lanes alpha = exp2(smaller(e, highest));
      const Lanes before = load(transmittance + at);
      Lanes weight = alpha * before;
      const Lanes after = before - weight;
      const Mask drawn = above_within(touched, after, stop);
      weight = keep(drawn, weight);
      store(transmittance + at,
            negative_where(without(touched, drawn), choose(drawn, after, before)));
      const Lanes v_red = load(g.images + at), v_green = load(g.images + PIXELS + at);
      const Lanes v_blue = load(g.images + 2 * PIXELS + at);
      Lanes gain = fma(blue, v_blue, fma(green, v_green, red * v_red));
      if (DEPTH) {
        const Lanes v_depth = load(g.images + 3 * PIXELS + at);
        gain = fma(depth, v_depth, gain);
        to_depth = fma(weight, v_depth, to_depth);
      }
      if (FEATURES) {
        gain = gain + load(weight_grads + at);
        store(weights + at, load(weights + at) + weight);
      }
      const Lanes rest = fnma(weight, gain, load(g.rest + at));
      store(g.rest + at, rest);
      const Lanes to_alpha = fnma(rest, reciprocal(one - alpha), before * gain);
      const Lanes v = keep(at_most_within(drawn, e, cut), alpha * to_alpha);
      m = m + v;
      mx = fma(v, all(blocks.dx[b]), mx);
      my = fma(v, all(blocks.dy[b]), my);
      mxx = fma(v, all(dxx[b]), mxx);
      mxy = fma(v, all(dxy[b]), mxy);
      myy = fma(v, all(dyy[b]), myy);
      to_red = fma(weight, v_red, to_red);
      to_green = fma(weight, v_green, to_green);
      to_blue = fma(weight, v_blue, to_blue);
    } while (todo);
    // From the block's first pixel to each lane's pixel: dx becomes dx - x, dy becomes dy - y.
    const Lanes sx = fnma(grid.x, m, mx), sy = fnma(grid.y, m, my);
    const Lanes sxx = fnma(grid.x, mx + sx, mxx), syy = fnma(grid.y, my + sy, myy);
    const Lanes sxy = fnma(grid.y, sx, fnma(grid.x, my, mxy));
    const Lanes each[10] = {m, sx, sy, sxx, sxy, syy, to_red, to_green, to_blue, to_depth};
    store_first(out.by_emission + std::int64_t(GRADIENTS) * entry->emission, sums(each),
                GRADIENTS);
  }
}

template <bool FEATURES>
inline void sweep_backward_any(const Inputs& in, const Tile& tile, Scratch& s, TileGradients& g,
                               bool depth, const PairGradients& out) {
  if (depth) {
    sweep_backward<FEATURES, true>(in, tile, s, g, out);
  } else {
    sweep_backward<FEATURES, false>(in, tile, s, g, out);
  }
}

void draw_backward(const Inputs& in, const Tile& tile, Scratch& s, const ConstImages& images,
                   const ConstImages& grads, const PairGradients& out) {
  TileGradients g;
  const Place place(in, tile);
  start_gradients(place, images, grads, g);
  if (!grads.features) {
    sweep_backward_any<false>(in, tile, s, g, grads.depths, out);
    return;
  }
  ++s.generation;
  int slots = 0;
  for (const Entry* entry = tile.begin; entry != tile.end; ++entry) {
    const std::uint16_t mask = tile.masks[entry->emission];
    if (!mask) continue;
    const int slot = slot_of(s, tile.records[entry->gaussian].anchor, slots, true);
    s.blocks_of_slot[slot] |= mask;
  }
  load_feature_gradients(in, place, images.features + place.offset, grads.features + place.offset,
                         s, g.rest);
  for (int quarter = 0; quarter < 4; ++quarter) {
    weight_gradients(in, tile, s, active_slots(s, slots, quarter), quarter);
  }
  sweep_backward_any<true>(in, tile, s, g, grads.depths, out);
  const std::int64_t row = padded(in.channels);
  for (int slot = 0; slot < slots; ++slot) {
    out.anchor_of_slot[slot] = s.anchor_of_slot[slot];
    for (int c = 0; c < row; c += 16) store(out.by_slot + slot * row + c, all(0.f));
  }
  for (int quarter = 0; quarter < 4; ++quarter) {
    feature_gradients(in, s, active_slots(s, slots, quarter), quarter, out.by_slot);
  }
}

}  // namespace
