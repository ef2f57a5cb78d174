#include "server/capture_service.h"

#include <gtest/gtest.h>

#include <limits>
#include <thread>

#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "motion/anatomy.h"
#include "server/replay/motion_source.h"
#include "tests/bus/test_domain.h"

namespace secondskin::server {
namespace {

using bus::eventually;
using bus::test_config;
using namespace std::chrono_literals;
namespace msg = bus::msg;

Motion some_motion(std::size_t poses, double rate_hz) {
  Motion motion{canonical_skeleton(), rate_hz, {}};
  for (std::size_t i = 0; i < poses; ++i) {
    motion.poses.emplace_back(kJointCount);
    motion.poses.back().p_WR = {static_cast<double>(i), 0.0, 1.0};
  }
  return motion;
}

TEST(CaptureService, PublishesEveryPoseOnceAndTheBodyForLateComers) {
  bus::Participant here(test_config()), there(test_config());
  MotionSource source(some_motion(60, 60.0));
  bus::Reader<msg::SkeletonPose> poses(there, bus::Want::kEvery);
  CaptureService service(here, source,
                         {.source_name = "test", .speed = 5.0, .wait_for_readers = 1});
  const auto counts = service.run({});
  EXPECT_EQ(counts.published, 60u);
  EXPECT_EQ(counts.refused, 0u);

  std::vector<msg::SkeletonPose> got;
  msg::SkeletonPose pose;
  ASSERT_TRUE(eventually([&] {
    while (poses.take(pose)) got.push_back(pose);
    return got.size() == 60;
  })) << got.size();
  for (std::size_t i = 0; i < got.size(); ++i) {
    EXPECT_EQ(got[i].header().frame(), i + 1);
    EXPECT_EQ(got[i].root_position().x(), static_cast<double>(i));
    EXPECT_GE(got[i].header().publish_ns(), got[i].header().stamp_ns());
    if (i > 0) {
      EXPECT_GT(got[i].header().stamp_ns(), got[i - 1].header().stamp_ns());
    }
  }
  // 59 periods of 1/300 s; never early.
  EXPECT_GE(got.back().header().stamp_ns() - got.front().header().stamp_ns(), 190'000'000);

  bus::Participant late(test_config());
  bus::Reader<msg::SkeletonDefinition> bodies(late);
  msg::SkeletonDefinition body;
  ASSERT_TRUE(eventually([&] { return bodies.take(body); }));
  EXPECT_EQ(body.skeleton_id(), got[0].skeleton_id());
  EXPECT_EQ(bus::to_skeleton(body).size(), kJointCount);
}

TEST(CaptureService, RefusesAndCountsAPoseThatIsNone) {
  bus::Participant here(test_config());
  Motion motion = some_motion(10, 100.0);
  motion.poses[4].q_PB[3].w() = std::numeric_limits<double>::quiet_NaN();
  motion.poses[7].p_WR.z() = std::numeric_limits<double>::infinity();
  MotionSource source(std::move(motion));
  CaptureService service(here, source, {.source_name = "test", .speed = 0.0});
  const auto counts = service.run({});
  EXPECT_EQ(counts.published, 8u);
  EXPECT_EQ(counts.refused, 2u);
}

TEST(CaptureService, LoopsUntilItIsStopped) {
  bus::Participant here(test_config()), there(test_config());
  bus::Reader<msg::SkeletonPose> poses(there, bus::Want::kEvery);
  MotionSource source(some_motion(5, 500.0));
  CaptureService service(here, source, {.source_name = "test", .loop = true});
  CaptureCounts counts;
  std::jthread runner([&](std::stop_token stop) { counts = service.run(stop); });
  std::uint64_t newest = 0;
  msg::SkeletonPose pose;
  EXPECT_TRUE(eventually([&] {
    while (poses.take(pose)) newest = pose.header().frame();
    return newest > 23;
  }));
  runner.request_stop();
  runner.join();
  EXPECT_GE(counts.published, 23u);
}

TEST(CaptureService, RefusesToBeTheSecondForASubject) {
  bus::Participant here(test_config()), there(test_config());
  MotionSource first(some_motion(5, 100.0)), second(some_motion(5, 100.0));
  CaptureService service(here, first, {.source_name = "first"});
  try {
    CaptureService other(there, second, {.source_name = "second"});
    FAIL() << "two capture servers publish the same subject";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find(here.config().subject), std::string::npos);
  }
}

}  // namespace
}  // namespace secondskin::server
