#include "team.hpp"

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>

#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif
#ifdef _OPENMP
#include <omp.h>
#else
#include <condition_variable>
#include <thread>
#endif

namespace instok3d {
namespace {

std::atomic<bool> forked{false};

struct Progress {
  std::atomic<std::int64_t> next{0};
  std::int64_t tasks = 0;
  // An exception that left a thread of the team would end the process: the first one is kept.
  std::atomic<bool> failed{false};
  std::mutex mutex;
  std::exception_ptr error;

  void keep_exception() {
    const std::lock_guard<std::mutex> lock(mutex);
    if (!error) error = std::current_exception();
    failed = true;
  }
};

void begin(const Stage& stage, Progress& progress) {
  progress.tasks = 0;
  progress.next.store(0, std::memory_order_relaxed);
  if (progress.failed) return;
  try {
    progress.tasks = stage.prepare();
  } catch (...) {
    progress.keep_exception();
  }
}

void work(const Stage& stage, Progress& progress, int thread) {
  try {
    while (!progress.failed) {
      const std::int64_t task = progress.next.fetch_add(1, std::memory_order_relaxed);
      if (task >= progress.tasks) return;
      stage.run(task, thread);
    }
  } catch (...) {
    progress.keep_exception();
  }
}

#ifdef _OPENMP

void run_team(int threads, const std::vector<Stage>& stages, Progress& progress) {
#pragma omp parallel num_threads(threads)
  {
    const int thread = omp_get_thread_num();
    for (const Stage& stage : stages) {
#pragma omp barrier
      if (thread == 0) begin(stage, progress);
#pragma omp barrier
      work(stage, progress, thread);
    }
  }
}

#else

class Barrier {
 public:
  explicit Barrier(int size) : size_(size) {}
  // For a team that came out smaller than wanted; called before the caller first waits.
  void resize(int size) {
    const std::lock_guard<std::mutex> lock(mutex_);
    size_ = size;
  }
  void wait() {
    std::unique_lock<std::mutex> lock(mutex_);
    const int round = round_;
    if (++waiting_ == size_) {
      waiting_ = 0;
      ++round_;
      changed_.notify_all();
    } else {
      changed_.wait(lock, [&] { return round != round_; });
    }
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  int size_, waiting_ = 0, round_ = 0;
};

void run_team(int threads, const std::vector<Stage>& stages, Progress& progress) {
  Barrier barrier(threads);
  const auto member = [&](int thread) {
    for (const Stage& stage : stages) {
      barrier.wait();
      if (thread == 0) begin(stage, progress);
      barrier.wait();
      work(stage, progress, thread);
    }
  };
  std::vector<std::thread> others;
  others.reserve(threads - 1);
  try {
    for (int thread = 1; thread < threads; ++thread) others.emplace_back(member, thread);
  } catch (const std::exception&) {  // no more threads, or no memory for one: fewer do it, too
    barrier.resize(1 + static_cast<int>(others.size()));
  }
  member(0);
  for (std::thread& other : others) other.join();
}

#endif

}  // namespace

void run_stages(int threads, const std::vector<Stage>& stages) {
  Progress progress;
  if (threads <= 1) {
    for (const Stage& stage : stages) {
      begin(stage, progress);
      work(stage, progress, 0);
    }
  } else {
    run_team(threads, stages, progress);
  }
  if (progress.error) std::rethrow_exception(progress.error);
}

int usable_threads(int wanted) {
#if defined(__unix__) || defined(__APPLE__)
  static const int registered = pthread_atfork(nullptr, nullptr, [] { forked = true; });
  (void)registered;
#endif
  return forked ? 1 : std::max(wanted, 1);
}

const char* threading_name() {
#ifdef _OPENMP
  return "OpenMP";
#else
  return "std::thread";
#endif
}

}  // namespace instok3d
