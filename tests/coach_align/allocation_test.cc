#include <gtest/gtest.h>

#include <cstddef>

#include "coach/score/repetition_scorer.h"
#include "tests/coach_align/trials.h"
#include "tests/count_malloc.h"

namespace secondskin::coach {
namespace {

// Both with a window over the whole reference and with the global search beside it, through starts,
// ends, leaps and rubbish.
TEST(Aligner, AllocatesNothingPerFrame) {
#ifdef COUNTS_MALLOC
  for (const char* name : {"low_block", "knife_hand_block"}) {
    for (const bool itself : {false, true}) {
      const Motion learner = shipped_learner(name);
      const auto reference = itself ? reference_of(learner) : shipped(name);
      Aligner aligner(reference);
      RepetitionScorer scorer(reference);
      JointVectors error;
      error.fill(Eigen::Vector3d::Zero());
      const Pose wrong(3);
      std::uint64_t scores = 0;
      const long before = allocations;
      for (std::size_t i = 0; i < learner.poses.size(); ++i) {
        const auto at = stamp(static_cast<double>(i) / 60.0);
        const Pose& pose = learner.poses[i * 7 % learner.poses.size()];
        const auto e = aligner.update(at, pose);
        if (scorer.update(at, pose, e, error, i)) ++scores;
        (void)aligner.update(at + 1, wrong);
      }
      aligner.reset();
      for (std::size_t i = 0; i < learner.poses.size(); ++i) {
        const auto at = stamp(100.0 + static_cast<double>(i) / 60.0);
        const Pose& pose = learner.poses[i];
        if (scorer.update(at, pose, aligner.update(at, pose), error, i)) ++scores;
      }
      if (scorer.finish()) ++scores;
      EXPECT_EQ(allocations - before, 0) << name;
      EXPECT_GT(scores, 0U);
    }
  }
#else
  GTEST_SKIP() << "the sanitizers replace malloc";
#endif
}

}  // namespace
}  // namespace secondskin::coach
