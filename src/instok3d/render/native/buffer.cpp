#include "buffer.hpp"

#include <cstdint>
#include <cstdlib>
#include <map>
#include <mutex>
#include <new>
#include <vector>

#ifdef __linux__
#include <sys/mman.h>
#endif
#ifdef _WIN32
#include <malloc.h>
#endif

namespace instok3d {
namespace {

constexpr std::size_t MAX_KEPT = std::size_t(256) << 20;
constexpr std::size_t MAX_BYTES = SIZE_MAX / 4;  // rounding up stays below SIZE_MAX
constexpr std::size_t HUGE_PAGE = std::size_t(2) << 20;

struct Pool {
  std::mutex mutex;
  std::map<std::size_t, std::vector<void*>> free;
  std::size_t kept = 0;
};

// Never destroyed: tensors that own buffers may outlive every static object.
Pool& pool() {
  static Pool* instance = new Pool;
  return *instance;
}

// Four sizes to each power of two, so that sizes that vary a little find each other's buffers.
std::size_t rounded(std::size_t bytes) {
  if (bytes > MAX_BYTES) throw std::bad_alloc();
  std::size_t step = 64;
  while (step * 8 < bytes) step *= 2;
  return (bytes + step - 1) / step * step;
}

void* allocate(std::size_t bytes) {
  const std::size_t alignment = bytes >= 2 * HUGE_PAGE ? HUGE_PAGE : 64;
  const std::size_t whole = (bytes + alignment - 1) / alignment * alignment;
#ifdef _WIN32
  void* data = _aligned_malloc(whole, alignment);
#else
  void* data = std::aligned_alloc(alignment, whole);
#endif
  if (!data) throw std::bad_alloc();
#ifdef __linux__
  // Planes of an image are a page or more apart: without large pages each tile walks hundreds.
  if (alignment == HUGE_PAGE) madvise(data, bytes, MADV_HUGEPAGE);
#endif
  return data;
}

void release(void* data) {
#ifdef _WIN32
  _aligned_free(data);
#else
  std::free(data);
#endif
}

}  // namespace

Buffer::Buffer(std::size_t bytes) : bytes_(rounded(bytes ? bytes : 1)) {
  {
    const std::lock_guard<std::mutex> lock(pool().mutex);
    auto& same_size = pool().free[bytes_];
    if (!same_size.empty()) {
      data_ = same_size.back();
      same_size.pop_back();
      pool().kept -= bytes_;
      return;
    }
  }
  data_ = allocate(bytes_);
}

Buffer::~Buffer() {
  if (!data_) return;
  const std::lock_guard<std::mutex> lock(pool().mutex);
  if (pool().kept + bytes_ <= MAX_KEPT) {
    try {
      pool().free[bytes_].push_back(data_);
      pool().kept += bytes_;
      return;
    } catch (const std::bad_alloc&) {  // no memory for the list: then this one goes back, too
    }
  }
  release(data_);
}

}  // namespace instok3d
