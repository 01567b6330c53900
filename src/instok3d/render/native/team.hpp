// Threads that work through the stages of a call together: one start, barriers in between.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

namespace instok3d {

struct Stage {
  // Called by one thread when the stage before is done; returns the number of tasks.
  std::function<std::int64_t()> prepare;
  // Called once for every task, in any order, by any thread.
  std::function<void(std::int64_t task, int thread)> run;
};

// Runs the stages on up to `threads` threads. The first exception of a `prepare` or a task is thrown
// again here, once all threads have stopped; tasks that had not begun are left out.
void run_stages(int threads, const std::vector<Stage>& stages);

// 1 in a forked child: a pool of threads does not survive a fork and would wait for ever.
int usable_threads(int wanted);

const char* threading_name();

}  // namespace instok3d
