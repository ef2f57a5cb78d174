#include <gtest/gtest.h>

#include "ring_rig.h"
#include "server/optical/track/body_tracker.h"
#include "server/optical/track/paper_chain.h"
#include "tests/count_malloc.h"

namespace secondskin::server {
namespace {

#ifdef COUNTS_MALLOC

TEST(OpticalTracking, AllocatesNothing) {
  const ProjectorRig rig = ring_rig();
  const std::vector<std::size_t> segment_of{0, 0, 0, 0, 1, 1};
  BodyTracker body(rig, segment_of);
  DetectorTracker singles(rig, 6);
  PaperChain paper(rig, 6);
  std::mt19937 random(1);
  ProjectorFrame frame(6, 16);
  MarkerFrame out(6);
  long calls = 0;
  int visible = 0;
  for (std::uint64_t k = 0; k < 200; ++k) {
    for (std::size_t d = 0; d < 6; ++d) {
      const Eigen::Vector3d p_W(0.1 * static_cast<double>(d), d % 2 == 0 ? 0.1 : 0.0, 1.0);
      // One of them comes and goes, one has torn sets: placing and forgetting are covered.
      const bool gone = d == 2 && k % 40 > 20;
      read_values(
          rig, [&](double) { return p_W; }, k, 0.5, random, d,
          [&](std::size_t p) { return sees_front(p) && !gone; }, frame);
      if (d == 3 && k % 30 < 10) std::fill_n(&frame.values[3 * 16], 16, std::uint8_t{77});
    }
    const long before = allocations;
    body.update(frame, out);
    singles.update(frame, out);
    paper.update(frame, out);
    calls += allocations - before;
    visible += out.visible[0];
  }
  EXPECT_EQ(calls, 0);
  EXPECT_GT(visible, 150);
}

#else

TEST(OpticalTracking, AllocatesNothing) { GTEST_SKIP() << "the sanitizers bring their own malloc"; }

#endif

}  // namespace
}  // namespace secondskin::server
