#include <gtest/gtest.h>

#include <chrono>
#include <cstddef>
#include <thread>

#include "coach/correct/solver_thread.h"
#include "problems.h"

// Eigen calls malloc itself, so malloc is what must be counted, and only this thread's: the solver
// may allocate on its own. The sanitizers bring their own malloc.
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define COUNTS_MALLOC 1

namespace {
thread_local long allocations = 0;
}

extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);

void* malloc(std::size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  ++allocations;
  return __libc_calloc(count, size);
}
void* realloc(void* at, std::size_t size) {
  ++allocations;
  return __libc_realloc(at, size);
}
}
#endif

namespace secondskin::coach {
namespace {

TEST(SolverThread, LivePathAllocatesNothing) {
#ifdef COUNTS_MALLOC
  const auto reference = shared(moving_reference());
  SolverThread thread(reference, canonical_skeleton(), {});
  const CorrectionProblem problem = swinging_problem(*reference, 1.0, 0.3);
  JointVectors error;
  int results = 0;
  const long before = allocations;
  for (int frame = 0; frame < 500; ++frame) {
    joint_errors(*reference, 1.0, problem.learner, error);
    if (thread.take(0)) ++results;
    if (thread.idle()) thread.post(problem);
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
  const long counted = allocations - before;
  EXPECT_EQ(counted, 0);
  EXPECT_GT(results, 1);
#else
  GTEST_SKIP() << "the sanitizers replace malloc";
#endif
}

}  // namespace
}  // namespace secondskin::coach
