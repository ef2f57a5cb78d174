#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <string>

#include "bus/pose_messages.h"
#include "bus/writer.h"
#include "motion/anatomy.h"
#include "test_domain.h"

namespace secondskin::bus {
namespace {

// Cyclone on this machine only: loopback, no multicast, found by unicast.
constexpr const char* kCycloneOnLoopback =
    "<General><Interfaces><NetworkInterface address='127.0.0.1' multicast='false'/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>30"
    "</MaxAutoParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>";

TEST(Openness, AProgramGeneratedByCycloneReadsTrueValues) {
  const Config config = test_config();
  ::setenv("CYCLONEDDS_URI", kCycloneOnLoopback, 1);
  int out[2];
  ASSERT_EQ(::pipe(out), 0);
  const pid_t subscriber = ::fork();
  if (subscriber == 0) {
    ::dup2(out[1], 1);
    ::close(out[0]);
    const std::string domain = std::to_string(config.domain);
    const std::string topic = full_topic_name(config.subject, "pose");
    ::execl(CYCLONE_SUBSCRIBER, CYCLONE_SUBSCRIBER, domain.c_str(), topic.c_str(), "10", "20",
            nullptr);
    ::_exit(127);
  }
  ::close(out[1]);
  FILE* lines = ::fdopen(out[0], "r");
  char line[512];
  ASSERT_NE(std::fgets(line, sizeof line, lines), nullptr);
  ASSERT_STREQ(line, "ready\n");

  // Poses go out at 100 Hz until ten were read; the first ones may pass before both sides have met.
  Participant participant(config);
  Writer<msg::SkeletonPose> writer(participant);
  std::jthread publisher([&writer](std::stop_token stop) {
    StampedPose pose{.frame = 0, .stamp_ns = 0, .pose = Pose(kJointCount)};
    pose.pose.q_PB[1] = Eigen::Quaterniond(0.5, -0.5, 0.5, -0.5);
    pose.pose.confidence[1] = 0.25f;
    msg::SkeletonPose message;
    while (!stop.stop_requested()) {
      ++pose.frame;
      pose.stamp_ns = 1'000'000'007 * static_cast<std::int64_t>(pose.frame);
      pose.pose.p_WR = {0.5 * static_cast<double>(pose.frame), -1.0, 0.875};
      to_message(pose, 1, message);
      writer.write(message);
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  });
  std::uint64_t last = 0;
  for (int i = 0; i < 10; ++i) {
    ASSERT_NE(std::fgets(line, sizeof line, lines), nullptr) << "after frame " << last;
    std::uint64_t frame = 0;
    ASSERT_EQ(std::sscanf(line, "frame %lu", &frame), 1) << line;
    char expected[512];
    std::snprintf(expected, sizeof expected,
                  "frame %lu stamp %ld root %.6f -1.000000 0.875000 joints 22 q1 0.500000 "
                  "-0.500000 0.500000 -0.500000 c1 0.250\n",
                  frame, 1'000'000'007 * static_cast<std::int64_t>(frame),
                  0.5 * static_cast<double>(frame));
    EXPECT_STREQ(line, expected);
    if (i > 0) {
      EXPECT_EQ(frame, last + 1) << "reliable: none is lost, none twice";
    }
    last = frame;
  }
  std::fclose(lines);
  int status = 0;
  ASSERT_EQ(::waitpid(subscriber, &status, 0), subscriber);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

}  // namespace
}  // namespace secondskin::bus
