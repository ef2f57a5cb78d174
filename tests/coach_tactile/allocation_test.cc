#include <gtest/gtest.h>

#include <cstddef>
#include <filesystem>

#include "coach/tactile/tactile_mapper.h"
#include "tests/count_malloc.h"

namespace secondskin::coach {
namespace {

TEST(TactileMapper, AllocatesNothing) {
#ifdef COUNTS_MALLOC
  TactileMapper mapper(
      BodyMap::load(std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "body_maps" / "arms.toml"));
  CorrectionResult correction;
  correction.status = SolverStatus::kConverged;
  JointVectors error = zero_vectors(), velocity = zero_vectors();
  SafeRangeMonitor safe_range(
      {{{Joint::kLeftElbow, Movement::kFlexion, -0.1, 0.5}, {Joint::kLeftHip, {}, -0.1, 0.5}}});
  Pose pose(kJointCount);
  std::array<double, kJointCount> tolerance;
  tolerance.fill(0.1);
  const long before = allocations;
  for (int frame = 0; frame < 1000; ++frame) {
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const double phase = 0.05 * frame + static_cast<double>(j);
      error[j] = Eigen::Vector3d(std::sin(phase), std::cos(phase), std::sin(2.0 * phase));
      correction.target[j] = error[j];
      correction.benefit[j] = 0.5 + 0.5 * std::sin(3.0 * phase);
    }
    velocity[index(Joint::kLeftElbow)].y() = 5.0 * std::sin(0.01 * frame);
    (void)mapper.update(frame * 16'000'000LL, correction, error, tolerance, true,
                        &safe_range.update(pose, velocity));
  }
  const long counted = allocations - before;
  EXPECT_EQ(counted, 0);
  EXPECT_GT(mapper.cues_given(), 10u);
#else
  GTEST_SKIP() << "the sanitizers replace malloc";
#endif
}

}  // namespace
}  // namespace secondskin::coach
