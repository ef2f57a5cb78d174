#include <gtest/gtest.h>

#include <filesystem>

#include "bus/reader.h"
#include "motion/retarget.h"
#include "server/wearable/wearable_topics.h"
#include "sim/wearable/simulated_measurements.h"
#include "sim/wearable/worn_garment.h"
#include "tests/bus/test_domain.h"

namespace secondskin::server {
namespace {

namespace msg = bus::msg;
using bus::eventually;

TEST(WearableTopics, TellHowSureEachPoseIsAndHowTheBoardsFare) {
  const std::filesystem::path root(SECONDSKIN_SOURCE_DIR);
  const sim::WornGarment worn(
      read_canonical(root / "reference_motions/squat/motion.bvh", root / "joint_maps"),
      Garment::load(root / "garments/practical.toml"), sim::WornErrors{}, 1);
  WearableOptions options;
  options.start.body = worn.assumed_skeleton();
  sim::MeasurementOptions measurements;
  measurements.faults.silent = {{3, 3.0, 100.0}};  // the head's board breaks down after the start
  WearableSource source(std::make_unique<sim::SimulatedMeasurements>(worn, 5, measurements),
                        worn.garment(), options);

  bus::Participant here(bus::test_config()), there(bus::test_config());
  WearableTopics topics(there, source);
  bus::Reader<msg::PoseUncertainty> uncertainties(here, bus::Want::kEvery);
  bus::Reader<msg::ServiceHealth> healths(here, bus::Want::kEvery);
  // Both sides have met when something comes; what is said before is lost, as in life.
  msg::PoseUncertainty got;
  ASSERT_TRUE(eventually([&] {
    topics.publish(source, Next::kPose);
    return uncertainties.take(got);
  }));
  while (uncertainties.take(got)) {
  }

  std::vector<double> expected;  // of the head, as the filter has it
  source.observe([&](const WearableSource& s, Next what) {
    if (what == Next::kPose) expected.push_back(s.filter().sigma(Joint::kHead).norm());
    topics.publish(s, what);
  });
  const auto sigma = [&](Joint joint) {
    const auto& v = got.rotations()[index(joint)];
    return Eigen::Vector3d(v.x(), v.y(), v.z()).norm();
  };
  StampedPose pose;
  std::size_t compared = 0;
  while (source.next(pose) == Next::kPose) {
    ASSERT_TRUE(eventually([&] { return uncertainties.take(got); })) << "frame " << pose.frame;
    ASSERT_EQ(got.header().frame(), pose.frame);
    ASSERT_EQ(got.rotations().size(), kJointCount);
    EXPECT_DOUBLE_EQ(sigma(Joint::kHead), expected.back());
    ++compared;
  }
  EXPECT_GT(compared, 50u);
  EXPECT_GT(sigma(Joint::kHead), 2.0 * sigma(Joint::kLeftKnee)) << "nothing measures the head";

  msg::ServiceHealth health;
  EXPECT_TRUE(eventually([&] {
    topics.publish(source, Next::kSilence);
    while (healths.take(health)) {
      if (health.message().to_string() == "head is silent: is it plugged in?") return true;
    }
    return false;
  })) << health.message().to_string();
}

}  // namespace
}  // namespace secondskin::server
