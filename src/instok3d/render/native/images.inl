// Tiles of images: sixteen blocks of 4x4 pixels in memory, rows of pixels in the image.

namespace {

// A tile's place in an image.
struct Place {
  std::int64_t plane, row, offset;  // floats
  int columns, rows;                // of the tile inside the image
  bool whole, aligned;
  Place(const Inputs& in, const Tile& tile)
      : plane(std::int64_t(in.height) * in.width), row(in.width),
        offset(std::int64_t(tile.y) * in.width + tile.x), columns(in.width - tile.x),
        rows(in.height - tile.y), whole(columns >= TILE && rows >= TILE),
        aligned(whole && in.width % 16 == 0) {
    if (columns > TILE) columns = TILE;
    if (rows > TILE) rows = TILE;
  }
};

// Four rows of sixteen pixels (of rows 4 quarter to 4 quarter + 3) to an image. `to` is the
// tile's first pixel; images are 64-byte aligned.
inline void put_rows(const Place& place, const Lanes (&rows)[4], int quarter, float* to) {
  to += 4 * quarter * place.row;
  if (place.aligned) {
    for (int i = 0; i < 4; ++i) stream(to + i * place.row, rows[i]);
  } else {
    for (int i = 0; i < 4 && 4 * quarter + i < place.rows; ++i) {
      store_first(to + i * place.row, rows[i], place.columns);
    }
  }
}

inline void get_rows(const Place& place, const float* from, int quarter, Lanes (&rows)[4]) {
  from += 4 * quarter * place.row;
  if (place.whole) {
    for (int i = 0; i < 4; ++i) rows[i] = load_unaligned(from + i * place.row);
  } else {
    for (int i = 0; i < 4; ++i) {
      rows[i] = 4 * quarter + i < place.rows ? load_first(from + i * place.row, place.columns)
                                             : all(0.f);
    }
  }
}

inline void put_tile(const Place& place, const float* blocks, float* image) {
  for (int quarter = 0; quarter < 4; ++quarter) {
    Lanes in[4], rows[4];
    for (int i = 0; i < 4; ++i) in[i] = load(blocks + 64 * quarter + 16 * i);
    swap_blocks_and_rows(in, rows);
    put_rows(place, rows, quarter, image + place.offset);
  }
}

inline void get_tile(const Place& place, const float* image, float* blocks) {
  for (int quarter = 0; quarter < 4; ++quarter) {
    Lanes rows[4], out[4];
    get_rows(place, image + place.offset, quarter, rows);
    swap_blocks_and_rows(rows, out);
    for (int i = 0; i < 4; ++i) store(blocks + 64 * quarter + 16 * i, out[i]);
  }
}

}  // namespace
