#include <gtest/gtest.h>

#include <cmath>

#include "bus/reader.h"
#include "session.h"

namespace secondskin::session {
namespace {

namespace msg = bus::msg;

// The number after "127.0.0.1:" in what a program says; 0 while it has not said it.
int port_in(const std::string& words) {
  const auto at = words.find("127.0.0.1:");
  return at == std::string::npos ? 0 : std::atoi(words.c_str() + at + 10);
}

class WearableCapture : public ::testing::Test {
 protected:
  Process garment(const char* how, const std::string& where) const {
    return session_.start(
        "garment", {"virtual-garment", SECONDSKIN_SOURCE_DIR "/reference_motions/squat/motion.bvh",
                    how, where, "--rest", "5"});
  }

  // Poses come, are whole, and say how sure they are; then the program ends when asked to.
  void expect_poses(const std::string& source) const {
    bus::Config config;
    config.domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
    config.subject = "test_" + std::to_string(::getpid());
    config.qos_file = SECONDSKIN_SOURCE_DIR "/idl/qos.xml";
    bus::Participant participant(config);
    bus::Reader<msg::SkeletonPose> poses(participant, bus::Want::kEvery);
    bus::Reader<msg::PoseUncertainty> uncertainties(participant, bus::Want::kEvery);
    Process capture = session_.start("capture", session_.on_bus({"capture", source}));
    std::size_t whole = 0, sure = 0;
    msg::SkeletonPose pose;
    msg::PoseUncertainty uncertainty;
    EXPECT_TRUE(eventually(
        [&] {
          while (poses.take(pose)) {
            const auto& q = pose.orientations()[0];
            const double norm = q.w() * q.w() + q.x() * q.x() + q.y() * q.y() + q.z() * q.z();
            EXPECT_NEAR(norm, 1.0, 1e-6);
            ++whole;
          }
          while (uncertainties.take(uncertainty)) {
            EXPECT_GT(uncertainty.rotations()[1].x(), 0.0);
            ++sure;
          }
          return whole >= 70 && sure >= 70;
        },
        40s))
        << whole << " poses, " << sure << " uncertainties; " << capture.output();
    capture.end(SIGTERM);
    ASSERT_TRUE(capture.wait(10s));
    EXPECT_EQ(capture.exit_code(), 0) << capture.output();
  }

  Session session_;
};

TEST_F(WearableCapture, FollowsALiveGarmentOnAPort) {
  const std::string port = session_.folder / "garment_port";
  const Process worn = garment("--port", port);
  ASSERT_TRUE(eventually([&] { return std::filesystem::exists(port); }, 20s)) << worn.output();
  expect_poses("wearable:" + port);
}

TEST_F(WearableCapture, FollowsALiveGarmentOnASocket) {
  const Process worn = garment("--tcp", "0");
  ASSERT_TRUE(eventually([&] { return port_in(worn.output()) > 0; }, 20s)) << worn.output();
  expect_poses("wearable:tcp:127.0.0.1:" + std::to_string(port_in(worn.output())));
}

}  // namespace
}  // namespace secondskin::session
