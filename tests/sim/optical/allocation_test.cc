#include <gtest/gtest.h>

#include "scenes.h"
#include "tests/count_malloc.h"

namespace secondskin::sim {
namespace {

TEST(VirtualRig, AllocatesNothingInACycle) {
#ifndef COUNTS_MALLOC
  GTEST_SKIP() << "the sanitizers bring their own malloc";
#else
  SuitScene scene(reference("squat"), shipped_suit("full_body"), AtEnd::kThereAndBack);
  OpticalNoise noise;
  noise.wild_share = 0.02;
  VirtualRig rig(second_skin_rig(), scene, noise, 1);
  std::vector<std::uint8_t> values(scene.detectors() * 16);
  rig.cycle(0.0, values);
  const long before = allocations;
  for (int i = 1; i < 100; ++i) rig.cycle(0.016 * i, values);
  EXPECT_EQ(allocations, before);
#endif
}

}  // namespace
}  // namespace secondskin::sim
