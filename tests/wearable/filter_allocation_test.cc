#include <gtest/gtest.h>

#include "tests/count_malloc.h"
#include "tests/wearable/resting_garment.h"

namespace secondskin::server {
namespace {

TEST(BodyFilter, AllocatesNothingAfterItsStart) {
#ifndef COUNTS_MALLOC
  GTEST_SKIP() << "a sanitizer has its own malloc";
#else
  const Skeleton skeleton = canonical_skeleton();
  const Garment garment = practical_garment();
  const auto X_BS = places(skeleton, garment);
  BodyFilter filter(skeleton, garment, X_BS, {});
  filter.start(Pose(kJointCount), 0, {});
  Measurement inertial = resting_inertial(garment, X_BS, 0), distances;
  distances.kind = MeasurementKind::kDistances;
  distances.distances.assign(garment.boards.size(), {0.6, 1.0});
  const long before = allocations;
  for (int i = 1; i < 60; ++i) {
    inertial.stamp_ns = 7'000'000 * i;
    distances.stamp_ns = inertial.stamp_ns - 4'000'000;
    distances.source = static_cast<std::size_t>(i) % garment.sources.size();
    filter.process(inertial);
    filter.process(distances);
    filter.observe_root(inertial.stamp_ns, Eigen::Isometry3d::Identity(), 0.01, 0.01);
  }
  EXPECT_EQ(allocations - before, 0);
#endif
}

}  // namespace
}  // namespace secondskin::server
