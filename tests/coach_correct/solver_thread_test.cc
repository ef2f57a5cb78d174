#include "coach/correct/solver_thread.h"

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "problems.h"

namespace secondskin::coach {
namespace {

using std::chrono::steady_clock;

CorrectionResult wait_for_result(SolverThread& thread) {
  const auto start = steady_clock::now();
  while (steady_clock::now() - start < std::chrono::seconds(20)) {
    if (auto result = thread.take(0)) return *result;
    std::this_thread::yield();
  }
  ADD_FAILURE() << "no result";
  return {};
}

TEST(SolverThread, GivesEachResultOnce) {
  const auto reference = shared(moving_reference());
  SolverThread thread(reference, canonical_skeleton(), {}, {.deadline = 5.0, .iterations = {}});
  CorrectionSolver alone(reference, canonical_skeleton());
  EXPECT_TRUE(thread.idle());
  EXPECT_FALSE(thread.take(0));
  for (std::uint64_t frame = 1; frame <= 40; ++frame) {
    CorrectionProblem problem =
        swinging_problem(*reference, 0.05 * static_cast<double>(frame), 0.3);
    problem.frame = frame;
    thread.post(problem);
    EXPECT_FALSE(thread.idle());
    const auto result = wait_for_result(thread);
    EXPECT_TRUE(thread.idle());
    EXPECT_FALSE(thread.take(frame));
    const auto expected = alone.solve(problem, {.deadline = 5.0, .iterations = {}});
    EXPECT_EQ(result.frame, frame);
    EXPECT_EQ(result.target, expected.target);
    EXPECT_EQ(result.iterations, expected.iterations);
  }
  EXPECT_GT(thread.cpu_time(), 0.0);
  EXPECT_LT(thread.cpu_time(), 20.0);
}

TEST(SolverThread, KeepsTheProblemUnderWay) {
  const auto reference = shared(moving_reference());
  SolverThread thread(reference, canonical_skeleton(), {}, {.deadline = 5.0, .iterations = {}});
  CorrectionProblem first = swinging_problem(*reference, 1.0, 0.3);
  first.frame = 1;
  thread.post(first);
  CorrectionProblem second = swinging_problem(*reference, 2.0, 0.3);
  second.frame = 2;
  thread.post(second);  // not idle: refused
  EXPECT_EQ(wait_for_result(thread).frame, 1u);
  EXPECT_TRUE(thread.idle());
}

// The live path asks at every frame and never waits.
TEST(SolverThread, NeverKeepsTheLivePathWaiting) {
  const auto reference = shared(moving_reference());
  SolverThread thread(reference, canonical_skeleton(), {});
  CorrectionProblem problem = swinging_problem(*reference, 1.0, 0.3);
  std::vector<double> took;
  int results = 0;
  for (int frame = 0; frame < 2000; ++frame) {
    const auto start = steady_clock::now();
    if (thread.take(0)) ++results;
    if (thread.idle()) {
      problem.reference_time = 1.0 + 1e-3 * frame;
      thread.post(problem);
    }
    took.push_back(std::chrono::duration<double>(steady_clock::now() - start).count());
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
  EXPECT_GT(results, 5);
  std::sort(took.begin(), took.end());
  EXPECT_LT(took[took.size() / 2], 1e-3);
}

TEST(SolverThread, EndsInAnyState) {
  const auto reference = shared(moving_reference());
  const CorrectionProblem problem = swinging_problem(*reference, 1.0, 0.3);
  { SolverThread idle(reference, canonical_skeleton(), {}); }
  {
    SolverThread posted(reference, canonical_skeleton(), {});
    posted.post(problem);
  }
  {
    SolverThread solving(reference, canonical_skeleton(), {});
    solving.post(problem);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  {
    SolverThread done(reference, canonical_skeleton(), {});
    done.post(problem);
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
}

}  // namespace
}  // namespace secondskin::coach
