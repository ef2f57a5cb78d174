#include "coach/coach_service.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <thread>

#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "bus/writer.h"
#include "motion/anatomy.h"
#include "tests/bus/test_domain.h"

// The coach as a service, between a test that plays the capture server and one that listens. The
// learner does the reference's motion, but with one arm bent, so that there is something to
// correct.

namespace secondskin::coach {
namespace {

using bus::eventually;
using bus::test_config;
using namespace std::chrono_literals;
namespace msg = bus::msg;

constexpr double kRate = 60.0;

// Both arms are raised to the front and lowered again, twice, within four seconds.
Motion arm_raise() {
  Motion motion{canonical_skeleton(), kRate, {}};
  for (int i = 0; i < static_cast<int>(4 * kRate); ++i) {
    Pose pose(kJointCount);
    pose.p_WR.z() = 1.0;
    const double phase = 2.0 * std::numbers::pi * i / (2.0 * kRate);
    const double raised = 0.7 * (1.0 - std::cos(phase));
    for (const Joint shoulder : {Joint::kLeftShoulder, Joint::kRightShoulder}) {
      pose.q_PB[index(shoulder)] = joint_rotation(shoulder, {raised, 0.1, 0.0});
    }
    motion.poses.push_back(pose);
  }
  return motion;
}

class CoachServiceTest : public testing::Test {
 protected:
  CoachServiceTest()
      : here_(test_config()),
        there_(test_config()),
        bodies_(here_),
        poses_(here_),
        orders_(here_),
        stops_(here_),
        commands_(there_, bus::Want::kEvery),
        alignments_(there_, bus::Want::kEvery),
        states_(there_, bus::Want::kEvery),
        health_(there_, bus::Want::kEvery),
        motion_(arm_raise()),
        reference_(std::make_shared<Reference>(make_reference("arm_raise", motion_))),
        service_(there_, options()) {}

  void SetUp() override {
    runner_ = std::jthread([this](std::stop_token stop) { summary_ = service_.run(stop); });
    msg::SkeletonDefinition body;
    bus::to_message(motion_.skeleton, "test", kRate, body);
    bodies_.write(body);
    ASSERT_TRUE(wait_for_state([](const auto& s) { return s.phase() == msg::SESSION_RUNNING; }));
    ASSERT_TRUE(eventually([&] { return poses_.counts().readers == 1; }));
    // Both sides have met when an answer comes; what passes before is lost, as in life.
    msg::TactorCommand answer;
    ASSERT_TRUE(eventually([&] {
      play(false);
      std::this_thread::sleep_for(20ms);
      return commands_.take(answer);
    }));
  }

  CoachServiceOptions options() const {
    CoachServiceOptions options;
    options.references = {reference_};
    options.body_map = BodyMap::load(SECONDSKIN_SOURCE_DIR "/body_maps/arms.toml");
    options.learner = "L-FIRST";
    options.find_plan = [](const std::string& name) {
      if (name != "two_blocks") throw std::runtime_error("no plan '" + name + "'");
      SessionPlan plan = SessionPlan::open();
      plan.name = name;
      plan.blocks[0].name = "alone";
      plan.blocks[0].repetitions = 1;
      plan.blocks[0].schedule.kind = FeedbackSchedule::Kind::kOff;
      plan.blocks.push_back(plan.blocks[0]);
      return plan;
    };
    options.find_reference = [this](const std::string& name) {
      if (name != "recorded_since") throw std::runtime_error("no reference '" + name + "'");
      auto reference = std::make_shared<Reference>(*reference_);
      reference->name = name;
      return reference;
    };
    return options;
  }

  template <class Condition>
  bool wait_for_state(Condition condition) {
    msg::SessionState state;
    return eventually([&] {
      while (states_.take(state)) {
        if (condition(state)) return true;
      }
      return false;
    });
  }

  // One pose of the learner, stamped as if measured at the reference's rate; waits until the coach
  // has answered, so that none is skipped.
  msg::TactorCommand play(bool expect_answer = true) {
    StampedPose pose{.frame = ++frame_, .stamp_ns = begin_ns_ + frame_ns(), .pose = {}};
    pose.pose = motion_.poses[(frame_ - 1) % motion_.poses.size()];
    auto& elbow = pose.pose.q_PB[index(Joint::kRightElbow)];
    elbow = joint_rotation(Joint::kRightElbow, {1.2, 0.0, 0.0});
    if (spoil_) elbow.w() = std::numeric_limits<double>::quiet_NaN();
    msg::SkeletonPose message;
    bus::to_message(pose, body_id_, message);
    poses_.write(message);
    msg::TactorCommand command;
    if (expect_answer) {
      EXPECT_TRUE(eventually([&] {
        while (commands_.take(command)) {
          if (command.header().frame() == frame_) return true;
        }
        return false;
      })) << "frame "
          << frame_;
    }
    // At the pace of life, so that the solver has time to think.
    std::this_thread::sleep_for(4ms);
    return command;
  }

  std::int64_t frame_ns() const {
    return static_cast<std::int64_t>(1e9 / kRate * static_cast<double>(frame_));
  }

  static bool is_on(const msg::TactorCommand& command) {
    return std::any_of(command.intensities().begin(), command.intensities().end(),
                       [](auto i) { return i > 0; });
  }

  // Plays until something is cued, at most the whole motion.
  bool play_until_on() {
    for (std::size_t i = 0; i < motion_.poses.size(); ++i) {
      if (is_on(play())) return true;
    }
    return false;
  }

  CoachSummary end() {
    runner_.request_stop();
    runner_.join();
    return summary_;
  }

  bus::Participant here_, there_;
  bus::Writer<msg::SkeletonDefinition> bodies_;
  bus::Writer<msg::SkeletonPose> poses_;
  bus::Writer<msg::SessionCommand> orders_;
  bus::Writer<msg::EmergencyStop> stops_;
  bus::Reader<msg::TactorCommand> commands_;
  bus::Reader<msg::Alignment> alignments_;
  bus::Reader<msg::SessionState> states_;
  bus::Reader<msg::ServiceHealth> health_;
  Motion motion_;
  std::shared_ptr<const Reference> reference_;
  CoachService service_;
  std::uint32_t body_id_ = bus::skeleton_id(motion_.skeleton);
  std::int64_t begin_ns_ = bus::now_ns();
  std::uint64_t frame_ = 0;
  bool spoil_ = false;
  CoachSummary summary_;
  std::jthread runner_;
};

TEST_F(CoachServiceTest, FollowsTheLearnerAndCuesTheBentArm) {
  ASSERT_TRUE(play_until_on());
  for (int i = 0; i < 30; ++i) play();
  msg::Alignment newest, message;
  while (alignments_.take(message)) newest = message;
  EXPECT_EQ(newest.header().frame(), frame_);
  EXPECT_EQ(newest.phase(), msg::PHASE_MOVING);
  // The motion is played as it is: where it is is known, but for the repeated raise in its middle.
  const double played = static_cast<double>(frame_ - 1) / kRate;
  EXPECT_NEAR(std::fmod(newest.reference_time(), 2.0), std::fmod(played, 2.0), 0.15);
  const auto summary = end();
  EXPECT_EQ(summary.refused, 0u);
  EXPECT_GT(summary.cues_by_joint[index(Joint::kRightElbow)], 0u);
  EXPECT_EQ(summary.cues_by_joint[index(Joint::kLeftElbow)], 0u);
}

TEST_F(CoachServiceTest, SurvivesAPoseThatIsNoneAndCountsIt) {
  ASSERT_TRUE(play_until_on());
  spoil_ = true;
  for (int i = 0; i < 3; ++i) play(false);
  spoil_ = false;
  for (int i = 0; i < 5; ++i) play();
  const auto summary = end();
  EXPECT_GE(summary.refused, 1u);  // of three in a row the newest at least is met
  EXPECT_LE(summary.refused + summary.lost, 3u);
  EXPECT_GE(summary.frames, 6u);
}

TEST_F(CoachServiceTest, IgnoresPosesOfAnotherBody) {
  play();
  body_id_ += 1;
  play(false);
  body_id_ -= 1;
  play();
  EXPECT_EQ(end().refused, 1u);
}

TEST_F(CoachServiceTest, CuesNothingWhilePausedAndGoesOnAfter) {
  ASSERT_TRUE(play_until_on());
  msg::SessionCommand order;
  order.action(msg::SESSION_PAUSE);
  orders_.write(order);
  ASSERT_TRUE(wait_for_state([](const auto& s) { return s.phase() == msg::SESSION_PAUSED; }));
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(is_on(play()));
  order.action(msg::SESSION_RESUME);
  orders_.write(order);
  ASSERT_TRUE(wait_for_state([](const auto& s) { return s.phase() == msg::SESSION_RUNNING; }));
  EXPECT_TRUE(play_until_on());
}

TEST_F(CoachServiceTest, CuesNothingWhileAnEmergencyStopIsInForce) {
  ASSERT_TRUE(play_until_on());
  msg::EmergencyStop stop;
  stop.active(true);
  stops_.write(stop);
  ASSERT_TRUE(wait_for_state([](const auto& s) { return s.stopped(); }));
  for (int i = 0; i < 60; ++i) EXPECT_FALSE(is_on(play()));
  stop.active(false);
  stop.publish_ns(bus::now_ns());  // a lift must be newer than the stop
  stops_.write(stop);
  ASSERT_TRUE(wait_for_state([](const auto& s) { return !s.stopped(); }));
  EXPECT_TRUE(play_until_on());
}

TEST_F(CoachServiceTest, NamesAReferenceThatItDoesNotKnow) {
  msg::SessionCommand order;
  order.action(msg::SESSION_START);
  order.reference("salto");
  orders_.write(order);
  msg::ServiceHealth health;
  EXPECT_TRUE(eventually([&] {
    while (health_.take(health)) {
      if (health.message().to_string().find("salto") != std::string::npos) return true;
    }
    return false;
  }));
}

TEST_F(CoachServiceTest, BeginsWhatACommandNames) {
  bus::Reader<msg::ReferenceMotionList> lists(here_, bus::Want::kEvery);
  msg::SessionCommand order;
  order.action(msg::SESSION_START);
  order.plan("two_blocks");
  order.reference("recorded_since");
  order.learner("L-SECOND");
  orders_.write(order);
  EXPECT_TRUE(wait_for_state([](const auto& s) {
    return s.plan().to_string() == "two_blocks" && s.blocks() == 2 &&
           s.reference().to_string() == "recorded_since" && s.learner().to_string() == "L-SECOND";
  }));
  msg::ReferenceMotionList list;
  EXPECT_TRUE(eventually([&] {
    while (lists.take(list)) {
      if (list.references().size() == 2) return true;
    }
    return false;
  }));
  for (int i = 0; i < 60; ++i) EXPECT_FALSE(is_on(play())) << "the plan's block is without cues";

  msg::SessionCommand back;  // empty keeps reference and learner
  back.action(msg::SESSION_START);
  back.plan("none");
  orders_.write(back);
  EXPECT_TRUE(wait_for_state([](const auto& s) {
    return s.plan().size() == 0 && s.reference().to_string() == "recorded_since" &&
           s.learner().to_string() == "L-SECOND";
  }));
  EXPECT_TRUE(play_until_on());
}

TEST_F(CoachServiceTest, GoesOnWithWhatItHasWhenACommandNamesAPlanThatIsNone) {
  ASSERT_TRUE(play_until_on());
  msg::SessionCommand order;
  order.action(msg::SESSION_START);
  order.plan("unheard_of");
  order.learner("L-SECOND");
  orders_.write(order);
  msg::ServiceHealth health;
  EXPECT_TRUE(eventually([&] {
    while (health_.take(health)) {
      if (health.message().to_string().find("no plan 'unheard_of'") != std::string::npos) {
        return true;
      }
    }
    return false;
  }));
  msg::SessionState state;
  while (states_.take(state)) EXPECT_EQ(state.learner().to_string(), "L-FIRST");
  EXPECT_TRUE(play_until_on());
}

TEST_F(CoachServiceTest, TurnsEverythingOffWhenItEnds) {
  ASSERT_TRUE(play_until_on());
  end();
  msg::TactorCommand command;
  bool any = false;
  while (commands_.take(command)) any = true;
  ASSERT_TRUE(any);
  EXPECT_FALSE(is_on(command));
}

}  // namespace
}  // namespace secondskin::coach
