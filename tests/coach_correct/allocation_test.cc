#include <gtest/gtest.h>

#include <chrono>
#include <cstddef>
#include <thread>

#include "coach/correct/solver_thread.h"
#include "problems.h"
#include "tests/count_malloc.h"

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
