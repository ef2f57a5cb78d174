#include "server/mvn/mvn_stream.h"

#include <gtest/gtest.h>

#include <random>

#include "clients/stream/mvn_streamer.h"
#include "motion/body_shape.h"
#include "motion/kinematics.h"
#include "motion/rotation.h"
#include "tests/motion/random_pose.h"

// What MVN's datagrams mean, without sockets: time is passed in.

namespace secondskin::server {
namespace {

using Eigen::Vector3d;

constexpr std::int64_t kStart_ns = 1'700'000'000'000'000'000;
constexpr std::uint32_t kPeriod_ms = 10;

// A person of MVN's in a T-pose, written down by hand: positions in metres, all orientations
// identity (protocol, section 2.6.2), ids after table 1 of section 3.1.
std::vector<wire::MvnSegment> t_pose_body() {
  const std::array<std::array<float, 3>, 23> places{{
      {0, 0, 0.95F},      {0, 0, 1.05F},      {0, 0, 1.15F},      {0, 0, 1.25F},
      {0, 0, 1.35F},      {0, 0, 1.50F},      {0, 0, 1.60F},  // head
      {0, -0.03F, 1.45F}, {0, -0.18F, 1.45F}, {0, -0.48F, 1.45F}, {0, -0.73F, 1.45F},
      {0, 0.03F, 1.45F},  {0, 0.18F, 1.45F},  {0, 0.48F, 1.45F},  {0, 0.73F, 1.45F},
      {0, -0.09F, 0.95F}, {0, -0.09F, 0.52F}, {0, -0.09F, 0.09F}, {0.15F, -0.09F, 0.03F},
      {0, 0.09F, 0.95F},  {0, 0.09F, 0.52F},  {0, 0.09F, 0.09F},  {0.15F, 0.09F, 0.03F},
  }};
  std::vector<wire::MvnSegment> segments;
  for (std::uint32_t i = 0; i < places.size(); ++i) {
    segments.push_back({i + 1, places[i], {1, 0, 0, 0}});
  }
  return segments;
}

wire::MvnHeader header(std::uint32_t sample, std::uint8_t avatar = 0) {
  wire::MvnHeader result;
  result.sample = sample;
  result.time_ms = kPeriod_ms * sample;
  result.avatar = avatar;
  return result;
}

std::int64_t arrival(std::uint32_t sample) {
  return kStart_ns + std::int64_t{kPeriod_ms} * 1'000'000 * sample;
}

class MvnStreamTest : public testing::Test {
 protected:
  // Sends one sample; @returns whether it gave a pose.
  bool send(std::uint32_t sample, const std::vector<wire::MvnSegment>& body = t_pose_body()) {
    return stream_.add(wire::encode_mvn_pose(header(sample), body), arrival(sample), pose_);
  }
  // Sends samples until one gives a pose. @returns its number
  std::uint32_t begin(const std::vector<wire::MvnSegment>& body = t_pose_body()) {
    for (std::uint32_t sample = 1; sample < 100; ++sample) {
      if (send(sample, body)) return sample;
    }
    ADD_FAILURE() << "no pose; " << stream_.trouble();
    return 0;
  }
  Vector3d direction(Joint from, Joint to) {
    std::array<Eigen::Isometry3d, kJointCount> X_WB;
    forward_kinematics(stream_.skeleton(), pose_.pose.p_WR, pose_.pose.q_PB, X_WB);
    return (X_WB[index(to)].translation() - X_WB[index(from)].translation()).normalized();
  }
  double angle(Joint joint, Movement movement) const {
    return joint_angles(joint, pose_.pose.q_PB[index(joint)])[static_cast<std::size_t>(movement)];
  }

  MvnStream stream_{{}};
  StampedPose pose_;
};

TEST_F(MvnStreamTest, TakesTheTPoseForArmsAbductedByAQuarterTurn) {
  begin();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const auto joint = static_cast<Joint>(j);
    const bool shoulder = joint == Joint::kLeftShoulder || joint == Joint::kRightShoulder;
    EXPECT_NEAR(angle(joint, Movement::kFlexion), 0.0, 1e-6) << joint_name(joint);
    EXPECT_NEAR(angle(joint, Movement::kAbduction), shoulder ? 0.5 * std::numbers::pi : 0.0, 1e-6)
        << joint_name(joint);
    EXPECT_NEAR(angle(joint, Movement::kRotation), 0.0, 1e-6) << joint_name(joint);
  }
  EXPECT_LT((pose_.pose.p_WR - Vector3d(0, 0, 0.95)).norm(), 1e-6);
  const Skeleton& body = stream_.skeleton();
  EXPECT_NEAR(body[index(Joint::kRightElbow)].p_PB.z(), -0.30, 1e-6);
  EXPECT_NEAR(body[index(Joint::kLeftKnee)].p_PB.z(), -0.43, 1e-6);
  EXPECT_NEAR(body[index(Joint::kSpineMiddle)].p_PB.z(), 0.20, 1e-6);
  EXPECT_LT((body[index(Joint::kLeftToes)].p_PB - Vector3d(0.15, 0, -0.06)).norm(), 1e-6);
  EXPECT_NEAR(average_stature(body), 1.75, 0.2);
}

// From the T-pose the right arm swings forward about the vertical, by +90 degrees; then the elbow
// bends by 90 degrees about the forearm's vertical axis, which brings the hand before the chest.
TEST_F(MvnStreamTest, UnderstandsAnArmHeldForwardWithTheElbowBent) {
  auto body = t_pose_body();
  const float h = std::sqrt(0.5F);
  const auto quarter = std::array<float, 4>{h, 0, 0, h};
  const auto half = std::array<float, 4>{0, 0, 0, 1};
  body[8].orientation = quarter;
  body[9] = {10, {0.30F, -0.18F, 1.45F}, half};
  body[10] = {11, {0.30F, 0.07F, 1.45F}, half};
  begin(body);
  EXPECT_LT((direction(Joint::kRightShoulder, Joint::kRightElbow) - Vector3d(1, 0, 0)).norm(),
            1e-6);
  EXPECT_LT((direction(Joint::kRightElbow, Joint::kRightWrist) - Vector3d(0, 1, 0)).norm(), 1e-6);
  EXPECT_NEAR(angle(Joint::kRightElbow, Movement::kFlexion), 0.5 * std::numbers::pi, 1e-5);
  EXPECT_NEAR(angle(Joint::kRightElbow, Movement::kAbduction), 0.0, 1e-5);
  EXPECT_NEAR(angle(Joint::kRightElbow, Movement::kRotation), 0.0, 1e-5);
  EXPECT_NEAR(angle(Joint::kLeftShoulder, Movement::kAbduction), 0.5 * std::numbers::pi, 1e-6);
}

TEST_F(MvnStreamTest, TellsCentimetresFromMetres) {
  auto body = t_pose_body();
  for (auto& segment : body) {
    for (float& value : segment.position) value *= 100.0F;
  }
  begin(body);
  body[0].position[2] += 10.0F;
  ASSERT_TRUE(send(200, body));
  EXPECT_NEAR(pose_.pose.p_WR.z(), 1.05, 1e-6);
  EXPECT_NEAR(stream_.skeleton()[index(Joint::kLeftKnee)].p_PB.z(), -0.43, 1e-6);
}

TEST(MvnStream, ReadsAStreamWithYUpWhenTold) {
  RetargetOptions options;
  options.up = UpAxis::kY;
  MvnStream stream(options);
  auto body = t_pose_body();
  const float h = std::sqrt(0.5F);
  body[13].orientation = {h, 0, 0, -h};  // z up: the left forearm points forward
  for (auto& s : body) {
    s.position = {s.position[0], s.position[2], -s.position[1]};
    s.orientation = {s.orientation[0], s.orientation[1], s.orientation[3], -s.orientation[2]};
  }
  StampedPose pose;
  std::uint32_t sample = 1;
  while (!stream.add(wire::encode_mvn_pose(header(sample), body), arrival(sample), pose)) {
    ASSERT_LT(++sample, 100u);
  }
  EXPECT_LT((pose.pose.p_WR - Vector3d(0, 0, 0.95)).norm(), 1e-6);
  const auto elbow = joint_angles(Joint::kLeftElbow, pose.pose.q_PB[index(Joint::kLeftElbow)]);
  EXPECT_NEAR(elbow[0], 0.5 * std::numbers::pi, 1e-5);
}

TEST_F(MvnStreamTest, GivesBackAnyPoseThatOurOwnSenderSends) {
  const Skeleton body = canonical_skeleton(1.66);
  stream::MvnStreamer sender("anna");
  sender.set_body(body);
  std::mt19937 random(11);
  double worst_angle = 0.0, worst_place = 0.0;
  for (std::uint64_t frame = 1; frame <= 500; ++frame) {
    StampedPose sent{frame, kStart_ns + static_cast<std::int64_t>(frame) * 10'000'000,
                     random_pose(random, kJointCount)};
    bool came = false;
    for (const auto& datagram : sender.encode(sent)) {
      EXPECT_LE(datagram.size(), stream::PoseEncoder::kMostBytes);
      came = stream_.add(datagram, sent.stamp_ns, pose_) || came;
    }
    if (!came) continue;
    worst_place = std::max(worst_place, (pose_.pose.p_WR - sent.pose.p_WR).norm());
    for (std::size_t j = 0; j < kJointCount; ++j) {
      worst_angle = std::max(worst_angle, geodesic_distance(pose_.pose.q_PB[j], sent.pose.q_PB[j]));
    }
  }
  EXPECT_GT(stream_.counts().poses, 440u);
  // Numbers of single precision: 6e-8 of a quaternion's part, and of some metres.
  EXPECT_LT(worst_angle, 1e-6);
  EXPECT_LT(worst_place, 1e-6);
  for (std::size_t j = 1; j < kJointCount; ++j) {
    EXPECT_LT((stream_.skeleton()[j].p_PB - body[j].p_PB).norm(), 2e-6) << body[j].name;
  }
}

TEST_F(MvnStreamTest, CountsLostSamplesAndNumbersTheFramesOn) {
  const std::uint32_t first = begin();
  const std::uint64_t frame = pose_.frame;
  ASSERT_TRUE(send(first + 1));
  EXPECT_EQ(pose_.frame, frame + 1);
  ASSERT_TRUE(send(first + 5));
  EXPECT_EQ(pose_.frame, frame + 5);
  EXPECT_EQ(stream_.counts().lost, 3u);
  EXPECT_EQ(pose_.stamp_ns, arrival(first + 5));
}

TEST_F(MvnStreamTest, LeavesOutWhatComesLate) {
  const std::uint32_t first = begin();
  ASSERT_TRUE(send(first + 2));
  EXPECT_FALSE(send(first + 1));
  EXPECT_FALSE(send(first + 2));  // a repeated one
  ASSERT_TRUE(send(first + 3));
  EXPECT_EQ(stream_.counts().late, 1u);
  EXPECT_EQ(stream_.counts().lost, 1u);
}

TEST_F(MvnStreamTest, JoinsSamplesThatCameInSeveralDatagrams) {
  const std::uint32_t first = begin();
  const auto body = t_pose_body();
  auto part = [&](std::uint32_t sample, std::size_t from, std::size_t to, std::uint8_t number) {
    auto h = header(sample);
    h.datagram = number;
    const std::vector<wire::MvnSegment> some(body.begin() + static_cast<std::ptrdiff_t>(from),
                                             body.begin() + static_cast<std::ptrdiff_t>(to));
    return stream_.add(wire::encode_mvn_pose(h, some), arrival(sample), pose_);
  };
  EXPECT_FALSE(part(first + 1, 0, 12, 0));
  EXPECT_TRUE(part(first + 1, 12, 23, 0x81));
  // The last one first.
  EXPECT_FALSE(part(first + 2, 12, 23, 0x81));
  EXPECT_TRUE(part(first + 2, 0, 12, 0));
  // One of the two is lost: no pose of it.
  EXPECT_FALSE(part(first + 3, 0, 12, 0));
  EXPECT_FALSE(part(first + 4, 12, 23, 0x81));
  EXPECT_TRUE(part(first + 4, 0, 12, 0));
  EXPECT_EQ(stream_.counts().incomplete, 1u);
  EXPECT_EQ(stream_.counts().lost, 1u);
}

TEST_F(MvnStreamTest, LeavesOutPropsAndFingers) {
  const std::uint32_t first = begin();
  auto body = t_pose_body();
  for (std::uint32_t id = 24; id <= 67; ++id) body.push_back({id, {9, 9, 9}, {0, 1, 0, 0}});
  ASSERT_TRUE(send(first + 1, body));
  EXPECT_LT((pose_.pose.p_WR - Vector3d(0, 0, 0.95)).norm(), 1e-6);
  // And in a datagram of their own, after the body.
  ASSERT_TRUE(send(first + 2));
  const std::vector<wire::MvnSegment> fingers(body.begin() + 23, body.end());
  EXPECT_FALSE(send(first + 2, fingers));
  ASSERT_TRUE(send(first + 3));
  EXPECT_EQ(stream_.counts().late + stream_.counts().lost + stream_.counts().incomplete, 0u);
}

TEST_F(MvnStreamTest, FollowsTheFirstAvatarHeard) {
  auto other = t_pose_body();
  for (auto& segment : other) segment.position[0] += 2.0F;
  std::size_t poses = 0;
  for (std::uint32_t sample = 1; sample < 100; ++sample) {
    for (const std::uint8_t avatar : {3, 0, 7}) {
      const auto& body = avatar == 3 ? t_pose_body() : other;
      if (!stream_.add(wire::encode_mvn_pose(header(sample, avatar), body), arrival(sample), pose_))
        continue;
      EXPECT_EQ(avatar, 3);
      EXPECT_NEAR(pose_.pose.p_WR.x(), 0.0, 1e-6);
      ++poses;
    }
  }
  EXPECT_EQ(stream_.avatar(), 3);
  EXPECT_EQ(stream_.counts().other_avatars, 2u * 99u);
  EXPECT_GT(poses, 40u);
}

TEST_F(MvnStreamTest, BeginsAnewWhenTheSenderDoes) {
  for (std::uint32_t sample = 5000; sample < 5100; ++sample) (void)send(sample);
  const std::uint64_t frame = pose_.frame;
  const std::int64_t stamp = pose_.stamp_ns;
  const auto again = [&](std::uint32_t sample) {
    return stream_.add(wire::encode_mvn_pose(header(sample), t_pose_body()), arrival(5100 + sample),
                       pose_);
  };
  ASSERT_TRUE(again(0));
  ASSERT_TRUE(again(1));
  EXPECT_EQ(pose_.frame, frame + 2);
  EXPECT_EQ(stream_.counts().lost, 0u);
  EXPECT_GT(pose_.stamp_ns, stamp);
}

TEST_F(MvnStreamTest, TellsTheRateFromItsFirstHalfSecond) {
  const std::uint32_t first = begin();
  EXPECT_NEAR(first * kPeriod_ms, 510, kPeriod_ms);
  EXPECT_EQ(stream_.rate_hz(), 100.0);
}

// A sample is never early: the time code, set against the earliest arrivals, is when it was taken.
TEST_F(MvnStreamTest, TakesTheTimeFromTheTimeCodeNotFromTheArrival) {
  std::mt19937 random(3);
  std::exponential_distribution<double> delay(1.0 / 4e6);  // mean 4 ms
  std::int64_t last_stamp = 0;
  double worst = 0.0;
  for (std::uint32_t sample = 1; sample < 2000; ++sample) {
    const std::int64_t at = arrival(sample) + static_cast<std::int64_t>(delay(random));
    if (!stream_.add(wire::encode_mvn_pose(header(sample), t_pose_body()), at, pose_)) continue;
    EXPECT_GT(pose_.stamp_ns, last_stamp);
    last_stamp = pose_.stamp_ns;
    worst = std::max(worst, std::abs(static_cast<double>(pose_.stamp_ns - arrival(sample))));
  }
  EXPECT_LT(worst, 1e6);
}

TEST_F(MvnStreamTest, SaysWhyNoPosesCome) {
  EXPECT_EQ(stream_.trouble(), "");
  const std::vector<std::uint8_t> foreign(30, 'x');
  EXPECT_FALSE(stream_.add(foreign, kStart_ns, pose_));
  EXPECT_NE(stream_.trouble().find("no MVN datagram"), std::string::npos) << stream_.trouble();
  auto euler = wire::encode_mvn_pose(header(1), t_pose_body());
  euler[5] = '1';
  EXPECT_FALSE(stream_.add(euler, kStart_ns, pose_));
  EXPECT_NE(stream_.trouble().find("type 01"), std::string::npos) << stream_.trouble();
  auto giant = t_pose_body();
  giant[16].position = {0, 0, -4};
  EXPECT_FALSE(send(2, giant));
  EXPECT_NE(stream_.trouble().find("right_knee"), std::string::npos) << stream_.trouble();
  begin();
  EXPECT_EQ(stream_.trouble(), "");
}

TEST_F(MvnStreamTest, SurvivesAnyBytesBetweenItsSamples) {
  std::mt19937 random(5);
  std::uniform_int_distribution<int> byte(0, 255), where(0, 759);
  const std::uint32_t first = begin();
  std::size_t poses = 0;
  for (std::uint32_t k = 1; k <= 2000; ++k) {
    auto bent = wire::encode_mvn_pose(header(first + k), t_pose_body());
    // Anywhere but in the sample counter, the time and the avatar, which nothing can check.
    for (int changes = 0; changes < 3; ++changes) {
      const int at = where(random);
      if (at >= 6 && at <= 16) continue;
      bent[static_cast<std::size_t>(at)] = static_cast<std::uint8_t>(byte(random));
    }
    if (stream_.add(bent, arrival(first + k), pose_)) {
      EXPECT_TRUE(pose_.pose.is_valid());
    }
    bent.resize(static_cast<std::size_t>(where(random)));
    EXPECT_FALSE(stream_.add(bent, arrival(first + k), pose_));
    if (send(first + k)) ++poses;
  }
  EXPECT_GT(stream_.counts().poses, 1900u);
  EXPECT_GT(stream_.counts().all_garbled(), 2000u);
}

}  // namespace
}  // namespace secondskin::server
