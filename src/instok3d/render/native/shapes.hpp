// Sizes of arrays at the door of the modules: behind it they are read without further looks.
#pragma once

#include <cstddef>
#include <initializer_list>
#include <stdexcept>
#include <string>

namespace instok3d {

// Throws std::invalid_argument, in Python a ValueError, unless the array has this shape.
template <class Array>
void require_shape(const char* name, const Array& array, std::initializer_list<std::size_t> shape) {
  bool fits = array.ndim() == shape.size();
  std::string wanted, found;
  for (std::size_t axis = 0; axis < shape.size(); ++axis) {
    fits = fits && array.shape(axis) == shape.begin()[axis];
    wanted += (axis ? ", " : "") + std::to_string(shape.begin()[axis]);
  }
  if (fits) return;
  for (std::size_t axis = 0; axis < array.ndim(); ++axis) {
    found += (axis ? ", " : "") + std::to_string(array.shape(axis));
  }
  throw std::invalid_argument(std::string(name) + " has the shape (" + found + "), wanted (" +
                              wanted + ")");
}

// The length of an axis as an int. Throws std::invalid_argument above the limit.
inline int require_length(const char* name, std::size_t length, std::size_t limit) {
  if (length <= limit) return static_cast<int>(length);
  throw std::invalid_argument(std::string(name) + " are " + std::to_string(length) +
                              ", the kernels take at most " + std::to_string(limit));
}

constexpr std::size_t MAX_LENGTH = std::size_t(1) << 30;  // of axes that are counted by ints
constexpr std::size_t MAX_SIDE = std::size_t(1) << 24;    // of an image: floats count its pixels

}  // namespace instok3d
