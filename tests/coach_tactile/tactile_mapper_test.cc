#include "coach/tactile/tactile_mapper.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <random>

namespace secondskin::coach {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kDegree = kPi / 180.0;
constexpr std::int64_t kFrame_ns = 16'000'000;
constexpr std::int64_t kHold_ns = 200'000'000;

BodyMap shipped(const std::string& name) {
  return BodyMap::load(std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "body_maps" /
                       (name + ".toml"));
}

std::array<double, kJointCount> ten_degrees() {
  std::array<double, kJointCount> tolerance;
  tolerance.fill(10.0 * kDegree);
  return tolerance;
}

/// A body in which some joints are asked to move, each by its error.
struct Scene {
  CorrectionResult correction;
  JointVectors error = zero_vectors();
  std::array<double, kJointCount> tolerance = ten_degrees();

  Scene() { correction.status = SolverStatus::kConverged; }
  Scene& ask(Joint joint, const Eigen::Vector3d& v, double benefit = 0.5) {
    correction.target[index(joint)] = v;
    correction.benefit[index(joint)] = benefit;
    error[index(joint)] = v;
    return *this;
  }
  wire::BoardState show(TactileMapper& mapper, std::int64_t stamp_ns = 0,
                        bool enabled = true) const {
    return mapper.update(stamp_ns, correction, error, tolerance, enabled);
  }
};

Eigen::Vector3d degrees(double x, double y, double z) { return kDegree * Eigen::Vector3d(x, y, z); }

std::size_t slots_on(const wire::BoardState& board) {
  return static_cast<std::size_t>(
      std::count_if(board.begin(), board.end(), [](std::uint8_t i) { return i != 0; }));
}

/// The one tactor that is driven; fails the test if there is another.
const Tactor& only_tactor(const BodyMap& map, const wire::BoardState& board) {
  EXPECT_EQ(slots_on(board), 1u);
  for (const Tactor& tactor : map.tactors) {
    if (board[wire::continuous_slot(tactor.channel)] != 0) return tactor;
    if (board[wire::pulsed_slot(tactor.channel)] != 0) return tactor;
  }
  ADD_FAILURE() << "no tactor";
  return map.tactors.front();
}

bool is_off(const wire::BoardState& board) { return slots_on(board) == 0; }

TEST(TactileMapper, IsOffWithoutErrorTargetOrLeave) {
  TactileMapper mapper(shipped("arms"));
  const auto elbow = [](double deg) { return Scene().ask(Joint::kLeftElbow, degrees(0, deg, 0)); };
  EXPECT_TRUE(is_off(Scene().show(mapper)));
  EXPECT_TRUE(is_off(elbow(10.0).show(mapper)));
  Scene unasked = elbow(30.0);
  unasked.correction.target = zero_vectors();
  EXPECT_TRUE(is_off(unasked.show(mapper)));
  Scene unsolved = elbow(30.0);
  unsolved.correction.status = SolverStatus::kNone;
  EXPECT_TRUE(is_off(unsolved.show(mapper)));
  EXPECT_TRUE(is_off(elbow(30.0).show(mapper, 0, false)));
  Scene broken = elbow(30.0);
  broken.error[index(Joint::kLeftElbow)].x() = std::nan("");
  EXPECT_TRUE(is_off(broken.show(mapper)));
  EXPECT_EQ(mapper.cues_given(), 0u);
  EXPECT_FALSE(is_off(elbow(30.0).show(mapper)));
  EXPECT_EQ(mapper.cues_given(), 1u);
}

TEST(TactileMapper, VibratesOnTheSideToMoveAwayFrom) {
  BodyMap map = shipped("arms");
  struct Case {
    Joint joint;
    Eigen::Vector3d target;
    Joint segment;
    double angle_deg;
  };
  // Flexion of a hanging arm lifts it forward, so the cue is on its back; and so on.
  const std::vector<Case> cases{
      {Joint::kLeftElbow, degrees(0, -30, 0), Joint::kLeftElbow, 180},
      {Joint::kLeftElbow, degrees(0, 30, 0), Joint::kLeftElbow, 0},
      {Joint::kRightShoulder, degrees(0, -30, 0), Joint::kRightShoulder, 180},
      {Joint::kLeftShoulder, degrees(30, 0, 0), Joint::kLeftShoulder, 270},    // abduction, to y
      {Joint::kRightShoulder, degrees(-30, 0, 0), Joint::kRightShoulder, 90},  // abduction, to -y
      {Joint::kRightWrist, degrees(30, 0, 0), Joint::kRightElbow, 270},        // flexion, inward
  };
  for (const bool repulsive : {true, false}) {
    map.repulsive = repulsive;
    for (const Case& c : cases) {
      TactileMapper mapper(map);
      const auto board = Scene().ask(c.joint, c.target).show(mapper);
      const Tactor& tactor = only_tactor(map, board);
      EXPECT_EQ(tactor.segment, c.segment);
      const double expected = (c.angle_deg + (repulsive ? 0 : 180)) * kDegree;
      EXPECT_NEAR(std::remainder(tactor.angle - expected, 2.0 * kPi), 0.0, 1e-6)
          << joint_name(c.joint);
    }
  }
}

TEST(TactileMapper, NamesTheMovement) {
  TactileMapper mapper(shipped("arms"));
  (void)Scene()
      .ask(Joint::kLeftElbow, degrees(0, -30, 0), 0.6)
      .ask(Joint::kRightShoulder, degrees(30, 0, 0), 0.3)
      .show(mapper);
  ASSERT_EQ(mapper.cues().size(), 2u);
  EXPECT_EQ(mapper.cues()[0].joint, Joint::kLeftElbow);
  EXPECT_EQ(mapper.cues()[0].movement, Movement::kFlexion);
  EXPECT_TRUE(mapper.cues()[0].positive);
  EXPECT_EQ(mapper.cues()[1].movement, Movement::kAbduction);
  EXPECT_FALSE(mapper.cues()[1].positive);
}

TEST(TactileMapper, FollowsAMovedTactor) {
  // The whole cuff turned on the arm: another channel, within an eighth of a turn the same place.
  for (double turned_deg = 0; turned_deg < 360; turned_deg += 15) {
    BodyMap map = shipped("right_arm");
    for (Tactor& tactor : map.tactors) tactor.angle += turned_deg * kDegree;
    TactileMapper mapper(map);
    const auto board = Scene().ask(Joint::kRightElbow, degrees(0, -30, 0)).show(mapper);
    const Tactor& tactor = only_tactor(map, board);
    EXPECT_LE(std::abs(std::remainder(tactor.angle - kPi, 2.0 * kPi)), 45.001 * kDegree);
  }
}

// How far round the limb the taps go, counterclockwise, in one tap's time.
double tap_direction(const BodyMap& map, const wire::BoardState& board) {
  wire::BoardPatterns patterns;
  for (std::size_t slot = 0; slot < wire::kSlotCount; ++slot)
    patterns.apply({slot, board[slot]}, 0.0);
  double sum = 0.0;
  const Tactor* last = nullptr;
  for (double time = 0.0; time < 1.0; time += 0.001) {
    std::array<double, wire::kTactorCount> level;
    patterns.drive(time, level);
    for (const Tactor& tactor : map.tactors) {
      if (level[tactor.channel] == 0.0 || &tactor == last) continue;
      if (last != nullptr) sum += std::remainder(tactor.angle - last->angle, 2.0 * kPi);
      last = &tactor;
    }
  }
  return sum;
}

TEST(TactileMapper, RunsTheRingInTheDirectionOfTheTurn) {
  std::mt19937 generator(1);
  std::uniform_real_distribution<double> turn(0.0, 2.0 * kPi);
  for (int draw = 0; draw < 200; ++draw) {
    BodyMap map = shipped("arms");
    // The cuffs are put on turned, and half of them with the channels the other way round.
    const double turned = turn(generator);
    const double way = draw % 2 == 0 ? 1.0 : -1.0;
    for (Tactor& tactor : map.tactors) tactor.angle = turned + way * tactor.angle;
    for (const Joint joint : {Joint::kLeftElbow, Joint::kRightElbow, Joint::kLeftShoulder}) {
      for (const double asked : {25.0, -40.0}) {
        TactileMapper mapper(map);
        const auto board = Scene().ask(joint, degrees(5, -3, asked)).show(mapper);
        ASSERT_EQ(slots_on(board), 1u);
        ASSERT_EQ(wire::mode_of_slot(mapper.cues()[0].slot), wire::Mode::kSaltation);
        ASSERT_GT(asked * tap_direction(map, board), 0.0);
      }
    }
  }
}

TEST(TactileMapper, CuesNoRotationWithoutARing) {
  BodyMap pair;
  pair.tactors = {{.channel = 0, .segment = Joint::kLeftShoulder, .angle = 0.0},
                  {.channel = 1, .segment = Joint::kLeftShoulder, .angle = kPi}};
  TactileMapper mapper(pair);
  EXPECT_TRUE(is_off(Scene().ask(Joint::kLeftShoulder, degrees(0, -5, 40)).show(mapper)));
  EXPECT_FALSE(is_off(Scene().ask(Joint::kLeftShoulder, degrees(0, -30, 40)).show(mapper)));
  BodyMap motors = shipped("arms");
  for (Tactor& tactor : motors.tactors) tactor.actuator = wire::Actuator::kDcMotor;
  TactileMapper slow(motors);
  EXPECT_TRUE(is_off(Scene().ask(Joint::kLeftShoulder, degrees(0, 0, 40)).show(slow)));
}

TEST(TactileMapper, CuesAJointWhereItsLimbWearsTactors) {
  const BodyMap map = shipped("full_body");
  struct Case {
    Joint joint;
    Eigen::Vector3d target;
    Joint segment;
    double angle_deg;
  };
  const std::vector<Case> cases{
      {Joint::kLeftShoulder, degrees(0, -30, 0), Joint::kLeftElbow, 180},  // outward along the arm
      {Joint::kSpineLower, degrees(0, 30, 0), Joint::kSpineUpper, 180},    // bend forward
      {Joint::kPelvis, degrees(0, -30, 0), Joint::kSpineUpper, 0},         // lean back
      {Joint::kRightHip, degrees(0, -30, 0), Joint::kRightHip, 180},       // thigh forward
      {Joint::kRightKnee, degrees(0, 30, 0), Joint::kRightHip,
       0},  // heel back: inward to the thigh
  };
  for (const Case& c : cases) {
    TactileMapper mapper(map);
    const auto board = Scene().ask(c.joint, c.target).show(mapper);
    const Tactor& tactor = only_tactor(map, board);
    EXPECT_EQ(tactor.segment, c.segment) << joint_name(c.joint);
    EXPECT_NEAR(std::remainder(tactor.angle - c.angle_deg * kDegree, 2.0 * kPi), 0.0, 1e-6)
        << joint_name(c.joint);
  }
  TactileMapper mapper(map);
  EXPECT_TRUE(is_off(Scene().ask(Joint::kHead, degrees(0, 40, 0)).show(mapper)));
  // Thighs wear no tactor at the sides.
  EXPECT_TRUE(is_off(Scene().ask(Joint::kLeftHip, degrees(40, 0, 0)).show(mapper)));
}

TEST(TactileMapper, GrowsWithTheErrorAndPulsesOnlyVoiceCoils) {
  for (const auto actuator : {wire::Actuator::kVoiceCoil, wire::Actuator::kDcMotor}) {
    BodyMap map = shipped("arms");
    for (Tactor& tactor : map.tactors) tactor.actuator = actuator;
    TactileMapper mapper(map);
    std::uint8_t last = 0;
    std::vector<double> levels;
    bool pulsed = false;
    std::int64_t stamp = 0;
    for (double deg = 0.0; deg < 60.0; deg += 0.25) {
      const auto board =
          Scene().ask(Joint::kLeftElbow, degrees(0, deg, 0)).show(mapper, stamp += kFrame_ns);
      ASSERT_TRUE(deg > 10.0 || is_off(board));
      if (is_off(board)) continue;
      const Cue cue = mapper.cues()[0];
      ASSERT_GE(cue.intensity, last);
      const bool is_pulsed = wire::mode_of_slot(cue.slot) == wire::Mode::kPulsed;
      ASSERT_TRUE(is_pulsed || !pulsed);  // once pulsed, pulsed
      pulsed = is_pulsed;
      if (cue.intensity != last) levels.push_back(wire::drive_of(cue.intensity).level);
      last = cue.intensity;
    }
    EXPECT_EQ(pulsed, actuator == wire::Actuator::kVoiceCoil);
    ASSERT_EQ(levels.size(), 5u);
    EXPECT_DOUBLE_EQ(levels.back(), 1.0);
    for (std::size_t i = 1; i < levels.size(); ++i) {
      EXPECT_GT(levels[i] / levels[i - 1], 1.2);  // amplitude JND 17-21 %
    }
    EXPECT_EQ(mapper.cues_given(), 1u);
  }
}

TEST(TactileMapper, HasNoMoreStepsThanCanBeToldApart) {
  BodyMap map = shipped("arms");
  for (Tactor& tactor : map.tactors) {
    tactor.threshold = 0.5;
    tactor.ceiling = 0.75;
  }
  TactileMapper mapper(map);
  std::vector<std::uint8_t> intensities;
  std::int64_t stamp = 0;
  for (double deg = 11.5; deg < 60.0; deg += 0.25) {
    (void)Scene().ask(Joint::kLeftElbow, degrees(0, deg, 0)).show(mapper, stamp += kFrame_ns);
    const std::uint8_t now = mapper.cues()[0].intensity;
    if (intensities.empty() || intensities.back() != now) intensities.push_back(now);
  }
  EXPECT_EQ(intensities.size(), 3u);  // 0.5, 0.61, 0.75
}

TEST(TactileMapper, DoesNotFlickerAtAnEdge) {
  TactileMapper mapper(shipped("arms"));
  std::int64_t stamp = 0;
  // Around the edge between two steps (10 + 12 degrees), and around the dead band's onset.
  for (const double edge : {22.0, 11.0}) {
    int changes = 0;
    std::uint8_t last = 0;
    for (int i = 0; i < 500; ++i) {
      const double deg = edge + 0.7 * std::sin(1.7 * i);
      (void)Scene().ask(Joint::kLeftElbow, degrees(0, deg, 0)).show(mapper, stamp += kFrame_ns);
      const std::uint8_t now = mapper.cues().empty() ? 0 : mapper.cues()[0].intensity;
      changes += now != last ? 1 : 0;
      last = now;
    }
    EXPECT_LE(changes, 2);
  }
  // A correction that points between two tactors, or between swing and rotation, stays at one.
  for (const Eigen::Vector3d& centre : {degrees(20, 20, 0), degrees(0, 20, 20)}) {
    TactileMapper steady(shipped("arms"));
    for (int i = 0; i < 500; ++i) {
      const Eigen::Vector3d wobble =
          0.03 * Eigen::Vector3d(std::sin(1.7 * i), std::sin(2.1 * i), 0);
      (void)Scene().ask(Joint::kLeftShoulder, centre + wobble).show(steady, stamp += kFrame_ns);
    }
    EXPECT_EQ(steady.cues_given(), 1u);
  }
}

TEST(TactileMapper, HoldsACueUntilItIsFeltUnlessItIsAnswered) {
  const Scene wrong = Scene().ask(Joint::kLeftElbow, degrees(0, 30, 0));
  Scene no_longer_asked = wrong;
  no_longer_asked.correction.target = zero_vectors();
  TactileMapper mapper(shipped("arms"));
  const auto shown = wrong.show(mapper, 0);
  EXPECT_EQ(no_longer_asked.show(mapper, kHold_ns / 2), shown);
  EXPECT_TRUE(is_off(no_longer_asked.show(mapper, kHold_ns)));

  TactileMapper answered(shipped("arms"));
  (void)wrong.show(answered, 0);
  EXPECT_TRUE(is_off(Scene().show(answered, kFrame_ns)));  // inside the dead band: at once

  TactileMapper stopped(shipped("arms"));
  (void)wrong.show(stopped, 0);
  EXPECT_TRUE(is_off(wrong.show(stopped, kFrame_ns, false)));
  EXPECT_TRUE(stopped.cues().empty());
}

TEST(TactileMapper, CuesTheMostUsefulJointsFirst) {
  TactileMapper mapper(shipped("arms"), {.max_cues = 2});
  Scene scene;
  scene.ask(Joint::kLeftElbow, degrees(0, 50, 0), 0.1)
      .ask(Joint::kRightElbow, degrees(0, 30, 0), 0.4)
      .ask(Joint::kRightShoulder, degrees(0, 20, 0), 0.3);
  (void)scene.show(mapper, 0);
  ASSERT_EQ(mapper.cues().size(), 2u);
  EXPECT_EQ(mapper.cues()[0].joint, Joint::kRightElbow);
  EXPECT_EQ(mapper.cues()[1].joint, Joint::kRightShoulder);
  // A much better one takes the weaker's place, but not before that was felt.
  scene.ask(Joint::kLeftElbow, degrees(0, 50, 0), 0.6);
  (void)scene.show(mapper, kFrame_ns);
  EXPECT_EQ(mapper.cues()[1].joint, Joint::kRightShoulder);
  (void)scene.show(mapper, kHold_ns);
  EXPECT_EQ(mapper.cues()[0].joint, Joint::kRightElbow);
  EXPECT_EQ(mapper.cues()[1].joint, Joint::kLeftElbow);
  // A slightly better one does not.
  scene.ask(Joint::kRightShoulder, degrees(0, 20, 0), 0.45);
  (void)scene.show(mapper, 3 * kHold_ns);
  EXPECT_EQ(mapper.cues()[0].joint, Joint::kRightElbow);
}

TEST(TactileMapper, LetsASegmentSpeakForOneJoint) {
  TactileMapper mapper(shipped("arms"), {.max_cues = 4});
  (void)Scene()
      .ask(Joint::kLeftElbow, degrees(0, 30, 0), 0.2)
      .ask(Joint::kLeftWrist, degrees(30, 0, 0), 0.4)
      .ask(Joint::kLeftShoulder, degrees(0, 30, 0), 0.1)
      .show(mapper);
  ASSERT_EQ(mapper.cues().size(), 2u);
  EXPECT_EQ(mapper.cues()[0].joint, Joint::kLeftWrist);
  EXPECT_EQ(mapper.cues()[1].joint, Joint::kLeftShoulder);
}

TEST(TactileMapper, MayBeToldToCueNothing) {
  TactileMapper mapper(shipped("arms"), {.max_cues = 0});
  EXPECT_TRUE(is_off(Scene().ask(Joint::kLeftElbow, degrees(0, 30, 0)).show(mapper)));
}

// Whatever is asked, in whatever order, on whatever map: never more cues than allowed, never a
// tactor beyond its ceiling, never a pulsed motor, and what the board renders agrees.
TEST(TactileMapper, NeverExceedsWhatTheMapAllows) {
  std::mt19937 generator(2);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> normal(0.0, 0.4);
  for (int trial = 0; trial < 100; ++trial) {
    BodyMap map = shipped(trial % 3 == 0 ? "full_body" : trial % 3 == 1 ? "arms" : "right_arm");
    std::array<double, wire::kTactorCount> ceiling{};
    for (Tactor& tactor : map.tactors) {
      tactor.ceiling = unit(generator);
      tactor.threshold = unit(generator) * tactor.ceiling;
      tactor.angle += 0.3 * normal(generator);
      if (unit(generator) < 0.2) tactor.actuator = wire::Actuator::kDcMotor;
      ceiling[tactor.channel] = tactor.ceiling;
    }
    const auto max_cues = static_cast<std::uint32_t>(4.0 * unit(generator));
    TactileMapper mapper(map, {.max_cues = max_cues});
    wire::BoardPatterns patterns;
    wire::BoardState before{};
    std::int64_t stamp = 0;
    Scene scene;
    for (int frame = 0; frame < 200; ++frame) {
      stamp += kFrame_ns;
      for (std::size_t j = 0; j < kJointCount; ++j) {
        if (unit(generator) < 0.9) continue;
        const bool none = unit(generator) < 0.3;
        scene.ask(static_cast<Joint>(j),
                  none ? Eigen::Vector3d::Zero()
                       : Eigen::Vector3d(normal(generator), normal(generator), normal(generator)),
                  unit(generator));
      }
      const bool enabled = unit(generator) < 0.97;
      const auto board = scene.show(mapper, stamp, enabled);
      ASSERT_LE(mapper.cues().size(), max_cues);
      ASSERT_EQ(slots_on(board), mapper.cues().size());
      ASSERT_TRUE(enabled || is_off(board));
      const double now = 1e-9 * static_cast<double>(stamp);
      for (std::size_t slot = 0; slot < wire::kSlotCount; ++slot) {
        if (board[slot] != before[slot]) patterns.apply({slot, board[slot]}, now);
      }
      ASSERT_EQ(patterns.state(), board);
      before = board;
      for (double t = now; t < now + 0.016; t += 0.001) {
        std::array<double, wire::kTactorCount> level;
        patterns.drive(t, level);
        for (std::size_t i = 0; i < level.size(); ++i) ASSERT_LE(level[i], ceiling[i]);
      }
      for (const Tactor& tactor : map.tactors) {
        if (tactor.actuator != wire::Actuator::kDcMotor) continue;
        ASSERT_EQ(board[wire::pulsed_slot(tactor.channel)], 0);
        ASSERT_EQ(board[wire::saltation_slot(tactor.channel / 4, false)], 0);
        ASSERT_EQ(board[wire::saltation_slot(tactor.channel / 4, true)], 0);
      }
    }
  }
}

TEST(TactileMapper, HoldsEveryCueForItsTimeUnderRandomCorrections) {
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> normal(0.0, 0.5);
  TactileMapper mapper(shipped("arms"));
  Scene scene;
  // Errors stay far outside their dead bands, so that only other reasons could end a cue.
  std::array<std::int64_t, wire::kTactorCount> since{};
  std::array<bool, wire::kTactorCount> on{};
  std::int64_t stamp = 0;
  for (int frame = 0; frame < 5000; ++frame) {
    stamp += kFrame_ns;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (unit(generator) < 0.8) continue;
      const Eigen::Vector3d v(normal(generator), normal(generator), normal(generator));
      scene.ask(static_cast<Joint>(j), v, unit(generator));
      scene.error[j] = Eigen::Vector3d(0.0, 0.6, 0.0);
      if (unit(generator) < 0.3) scene.correction.target[j].setZero();
    }
    const auto board = scene.show(mapper, stamp);
    for (std::size_t i = 0; i < wire::kTactorCount; ++i) {
      const bool now = board[wire::continuous_slot(i)] != 0 || board[wire::pulsed_slot(i)] != 0;
      ASSERT_TRUE(!on[i] || now || stamp - since[i] >= kHold_ns);
      if (now && !on[i]) since[i] = stamp;
      on[i] = now;
    }
  }
  EXPECT_GT(mapper.cues_given(), 100u);
}

TEST(TactileMapper, GivesTheSameBoardForTheSameInputs) {
  std::mt19937 generator(4);
  std::normal_distribution<double> normal(0.0, 0.5);
  TactileMapper first(shipped("full_body")), second(shipped("full_body"));
  Scene scene;
  for (int frame = 0; frame < 500; ++frame) {
    const auto joint = static_cast<Joint>(frame % static_cast<int>(kJointCount));
    scene.ask(joint, {normal(generator), normal(generator), normal(generator)},
              std::abs(normal(generator)));
    EXPECT_EQ(scene.show(first, frame * kFrame_ns), scene.show(second, frame * kFrame_ns));
  }
}

}  // namespace
}  // namespace secondskin::coach
