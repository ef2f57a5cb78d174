#include <gtest/gtest.h>

#include "moving_body.h"
#include "server/markers/body_fit.h"
#include "server/markers/triangles.h"
#include "tests/count_malloc.h"

namespace secondskin::server {
namespace {

#ifdef COUNTS_MALLOC

TEST(BodyFit, AllocatesNothingPerFrame) {
  const MarkerSet set = plug_in_gait();
  const Motion truth = moving_body(60);
  const MarkerMotion markers = markers_on(truth, set, 0.002);
  const MarkerBody body = exact_body(truth, set);
  BodyFit fit(body);
  TriangleSkeleton triangles({{Joint::kPelvis, Eigen::Isometry3d::Identity(), {0, 1, 2, 3}}},
                             markers.frames[0]);
  Pose pose;
  (void)fit.update(markers.frames[0], 0.01, pose);
  triangles.update(markers.frames[0], pose);
  MarkerFrame gone = markers.frames[30];
  gone.visible.assign(gone.visible.size(), 0);
  MarkerFrame away = markers.frames[30];
  for (Eigen::Vector3d& p : away.p_WM) p.x() += 3.0;
  const long before = allocations;
  for (const MarkerFrame& frame : markers.frames) {
    (void)fit.update(frame, 0.01, pose);
    triangles.update(frame, pose);
  }
  (void)fit.update(gone, 0.01, pose);
  EXPECT_TRUE(fit.update(away, 0.01, pose).restarted);  // also when it begins anew
  EXPECT_EQ(allocations, before);
}

#else

TEST(AllocationCounter, NeedsItsOwnMalloc) {
  GTEST_SKIP() << "a sanitizer replaces malloc in this build";
}

#endif

}  // namespace
}  // namespace secondskin::server
