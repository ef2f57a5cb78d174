#include "coach/tactile/tactile_mapper.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <random>

#include "coach/tactile/envelope.h"

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

/// Cues without an end, for what is seen over a longer time.
constexpr TactileOptions kEndless{.max_hold = 1e9, .pause = 0.0};

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

/// Where one tactor, or a phantom of two, is felt: by the energy of each.
double felt_angle(const BodyMap& map, const wire::BoardState& board) {
  std::vector<std::pair<double, double>> driven;
  for (const Tactor& tactor : map.tactors) {
    const std::uint8_t intensity = std::max(board[wire::continuous_slot(tactor.channel)],
                                            board[wire::pulsed_slot(tactor.channel)]);
    const double level = wire::drive_of(intensity).level;
    if (level > 0.0) driven.emplace_back(tactor.angle, level * level);
  }
  if (driven.size() == 1) return driven[0].first;
  if (driven.size() != 2) {
    ADD_FAILURE() << driven.size() << " tactors";
    return 0.0;
  }
  const double arc = std::remainder(driven[1].first - driven[0].first, 2.0 * kPi);
  return driven[0].first + arc * driven[1].second / (driven[0].second + driven[1].second);
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
  // The whole cuff turned on the arm: other channels, within a sixteenth of a turn the same place.
  for (double turned_deg = 0; turned_deg < 360; turned_deg += 15) {
    BodyMap map = shipped("right_arm");
    for (Tactor& tactor : map.tactors) tactor.angle += turned_deg * kDegree;
    TactileMapper mapper(map);
    const auto board = Scene().ask(Joint::kRightElbow, degrees(0, -30, 0)).show(mapper);
    EXPECT_LE(std::abs(std::remainder(felt_angle(map, board) - kPi, 2.0 * kPi)), 22.501 * kDegree);
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

TEST(TactileMapper, ServesExactlyTheJointsOfLimbsThatWearTactors) {
  const TactileMapper mapper(shipped("right_arm"));
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const bool right_arm = j >= index(Joint::kRightClavicle) && j <= index(Joint::kRightWrist);
    EXPECT_EQ(mapper.served()[j], right_arm) << joint_name(static_cast<Joint>(j));
  }
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
    for (const Tactor& tactor : map.tactors) {
      const bool driven = board[wire::continuous_slot(tactor.channel)] != 0 ||
                          board[wire::pulsed_slot(tactor.channel)] != 0;
      EXPECT_TRUE(!driven || tactor.segment == c.segment) << joint_name(c.joint);
    }
    EXPECT_NEAR(std::remainder(felt_angle(map, board) - c.angle_deg * kDegree, 2.0 * kPi), 0.0,
                1e-6)
        << joint_name(c.joint);
  }
  TactileMapper mapper(map);
  EXPECT_TRUE(is_off(Scene().ask(Joint::kHead, degrees(0, 40, 0)).show(mapper)));
}

TEST(TactileMapper, SaysTheMovementsOfTheMainJointsOnTheFullBodyMap) {
  const BodyMap map = shipped("full_body");
  for (const Joint joint :
       {Joint::kLeftShoulder, Joint::kRightShoulder, Joint::kLeftElbow, Joint::kRightElbow,
        Joint::kLeftHip, Joint::kRightHip, Joint::kLeftKnee, Joint::kSpineLower}) {
    const JointAnatomy& anatomy = canonical_anatomy()[index(joint)];
    const bool trunk = joint == Joint::kSpineLower;
    const bool arm = index(joint) < index(Joint::kLeftHip) && !trunk;
    for (const Movement movement :
         {Movement::kFlexion, Movement::kAbduction, Movement::kRotation}) {
      const auto m = static_cast<std::size_t>(movement);
      if (anatomy.range[m].min == anatomy.range[m].max) continue;
      if (movement == Movement::kRotation && !arm) continue;  // two rings: the arms have them
      if (movement == Movement::kAbduction && trunk) continue;
      std::vector<double> where;
      for (const double side : {-30.0, 30.0}) {
        const Eigen::Vector3d target = side * kDegree * anatomy.axis[m];
        TactileMapper mapper(map);
        EXPECT_GT(mapper.tells(joint, target), 0.99) << joint_name(joint) << " " << m;
        const auto board = Scene().ask(joint, target).show(mapper);
        ASSERT_FALSE(is_off(board));
        if (movement != Movement::kRotation) where.push_back(felt_angle(map, board));
      }
      if (where.size() == 2) {  // the two ways are felt on opposite sides
        EXPECT_NEAR(std::abs(std::remainder(where[0] - where[1], 2.0 * kPi)), kPi, 46.0 * kDegree);
      }
    }
  }
}

TEST(TactileMapper, GrowsWithTheErrorAndPulsesOnlyVoiceCoils) {
  for (const auto actuator : {wire::Actuator::kVoiceCoil, wire::Actuator::kDcMotor}) {
    BodyMap map = shipped("arms");
    for (Tactor& tactor : map.tactors) tactor.actuator = actuator;
    TactileMapper mapper(map, kEndless);
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
  TactileMapper mapper(shipped("arms"), kEndless);
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
    TactileMapper steady(shipped("arms"), kEndless);
    for (int i = 0; i < 500; ++i) {
      const Eigen::Vector3d wobble =
          0.03 * Eigen::Vector3d(std::sin(1.7 * i), std::sin(2.1 * i), 0);
      (void)Scene().ask(Joint::kLeftShoulder, centre + wobble).show(steady, stamp += kFrame_ns);
    }
    EXPECT_EQ(steady.cues_given(), 1u);
  }
}

TEST(TactileMapper, HoldsACueUntilItIsFelt) {
  const Scene wrong = Scene().ask(Joint::kLeftElbow, degrees(0, 30, 0));
  Scene no_longer_asked = wrong;
  no_longer_asked.correction.target = zero_vectors();
  TactileMapper mapper(shipped("arms"));
  const auto shown = wrong.show(mapper, 0);
  EXPECT_EQ(no_longer_asked.show(mapper, kHold_ns / 2), shown);
  EXPECT_TRUE(is_off(no_longer_asked.show(mapper, kHold_ns)));

  // A click of a frame says nothing: even when the error is gone the cue is felt first.
  TactileMapper answered(shipped("arms"));
  (void)wrong.show(answered, 0);
  EXPECT_FALSE(is_off(Scene().show(answered, kFrame_ns)));
  EXPECT_TRUE(is_off(Scene().show(answered, kHold_ns)));

  TactileMapper stopped(shipped("arms"));
  (void)wrong.show(stopped, 0);
  EXPECT_TRUE(is_off(wrong.show(stopped, kFrame_ns, false)));
  EXPECT_TRUE(stopped.cues().empty());
}

TEST(TactileMapper, SpeaksAndThenWaitsForTheAnswer) {
  const Scene wrong = Scene().ask(Joint::kLeftElbow, degrees(0, 30, 0));
  for (const TactileOptions& options : {TactileOptions{}, TactileOptions{.pause = 1.0}}) {
    TactileMapper mapper(shipped("arms"), options);
    std::vector<double> changes;
    bool on = false;
    for (std::int64_t stamp = kFrame_ns; stamp < 3'000'000'000; stamp += kFrame_ns) {
      const bool now = !is_off(wrong.show(mapper, stamp));
      if (now != on) changes.push_back(1e-9 * static_cast<double>(stamp));
      on = now;
    }
    ASSERT_GT(changes.size(), 3u);
    for (std::size_t i = 1; i < changes.size(); ++i) {
      const double wanted = i % 2 == 1 ? options.max_hold : options.pause;
      EXPECT_NEAR(changes[i] - changes[i - 1], wanted, 0.035);
    }
  }
  // An alarm goes on as long as its reason does.
  SafeRangeAlarm alarm;
  alarm.target = zero_vectors();
  alarm.excess[index(Joint::kLeftElbow)] = 0.2;
  alarm.target[index(Joint::kLeftElbow)] = degrees(0, 30, 0);
  TactileMapper mapper(shipped("arms"));
  for (std::int64_t stamp = kFrame_ns; stamp < 2'000'000'000; stamp += kFrame_ns) {
    EXPECT_FALSE(is_off(mapper.update(stamp, {}, wrong.error, wrong.tolerance, false, &alarm)));
  }
}

TEST(TactileMapper, ATurnGoesOnceRoundItsRing) {
  for (const double deg : {12.0, 45.0}) {
    const Scene wrong = Scene().ask(Joint::kLeftElbow, degrees(0, 0, deg));
    TactileMapper mapper(shipped("arms"));
    std::int64_t off_ns = 0;
    std::uint8_t intensity = 0;
    for (std::int64_t stamp = kFrame_ns; off_ns == 0 && stamp < 3'000'000'000; stamp += kFrame_ns) {
      if (is_off(wrong.show(mapper, stamp))) {
        off_ns = stamp;
      } else {
        intensity = mapper.cues()[0].intensity;
      }
    }
    const double round = 8.0 * wire::drive_of(intensity).tap_interval;
    EXPECT_NEAR(1e-9 * static_cast<double>(off_ns - kFrame_ns), round, 0.035) << deg;
  }
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
      ASSERT_GE(slots_on(board), mapper.cues().size());
      ASSERT_LE(slots_on(board), 2 * mapper.cues().size());
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

// Israr & Poupyrev 2011: energies add up, and the nearer tactor has more of it.
TEST(TactileMapper, SplitsAPhantomsEnergyBetweenItsTactors) {
  for (double beta = 0.0; beta <= 1.0; beta += 0.01) {
    const auto [a, b] = phantom_weights(beta);
    EXPECT_NEAR(a * a + b * b, 1.0, 1e-12);
    EXPECT_NEAR(b * b, beta, 1e-12);
  }
  // Halfway between front and left of a ring of four, and a third from front of a wider gap.
  BodyMap map = shipped("full_body");
  for (const Joint joint : {Joint::kLeftElbow, Joint::kLeftHip}) {
    const double turned = 45.0;
    const double away = turned * kDegree + kPi;
    // Moving towards `away`: v x (0, 0, -1) = (-v.y, v.x).
    const Eigen::Vector3d target =
        25.0 * kDegree * Eigen::Vector3d(std::sin(away), -std::cos(away), 0);
    TactileMapper mapper(map);
    const auto board = Scene().ask(joint, target).show(mapper);
    EXPECT_EQ(slots_on(board), 2u);
    EXPECT_NEAR(std::remainder(felt_angle(map, board) - turned * kDegree, 2.0 * kPi), 0.0,
                3.0 * kDegree);
    ASSERT_TRUE(mapper.cues()[0].second_slot);
  }
}

TEST(TactileMapper, PulsesBothTactorsOfAPhantomInStep) {
  const BodyMap map = shipped("full_body");
  TactileMapper mapper(map);
  const double away = 45.0 * kDegree + kPi;
  const Eigen::Vector3d target =
      60.0 * kDegree * Eigen::Vector3d(std::sin(away), -std::cos(away), 0);
  (void)Scene().ask(Joint::kLeftHip, target).show(mapper);
  const Cue cue = mapper.cues()[0];
  ASSERT_EQ(wire::mode_of_slot(cue.slot), wire::Mode::kPulsed);
  ASSERT_TRUE(cue.second_slot);
  EXPECT_EQ(wire::mode_of_slot(*cue.second_slot), wire::Mode::kPulsed);
  EXPECT_EQ(cue.intensity, cue.second_intensity);
}

TEST(TactileMapper, MakesNoPhantomWhereTheLearnerConfusesTheSites) {
  BodyMap map = shipped("arms");
  const Eigen::Vector3d between = degrees(-20, -20, 0);
  for (const bool confused : {false, true}) {
    for (Tactor& tactor : map.tactors) tactor.no_phantom_with = confused ? 0xFFFF : 0;
    TactileMapper mapper(map);
    EXPECT_EQ(slots_on(Scene().ask(Joint::kLeftElbow, between).show(mapper)), confused ? 1u : 2u);
  }
}

TEST(TactileMapper, TapsInTheClassicRangeOfSaltation) {
  TactileMapper mapper(shipped("arms"));
  std::int64_t stamp = 0;
  for (double deg = 11.5; deg < 60.0; deg += 0.5) {
    (void)Scene().ask(Joint::kLeftElbow, degrees(0, 0, deg)).show(mapper, stamp += kFrame_ns);
    const double tap = wire::drive_of(mapper.cues()[0].intensity).tap_interval;
    EXPECT_GE(tap, 0.020);
    EXPECT_LE(tap, 0.100);
  }
}

TEST(TactileMapper, PushesAMotorToItsLevelAndNoFurther) {
  BodyMap map = shipped("arms");
  for (Tactor& tactor : map.tactors) {
    tactor.actuator = wire::Actuator::kDcMotor;
    tactor.ceiling = 0.9;
  }
  const Scene scene = Scene().ask(Joint::kLeftElbow, degrees(0, 23, 0));
  TactileMapper mapper(map, kEndless);
  const auto first = scene.show(mapper, kFrame_ns);
  const Cue cue = mapper.cues()[0];
  const double level = wire::drive_of(cue.intensity).level;
  ASSERT_LT(level, 0.7);
  EXPECT_GT(first[cue.slot], cue.intensity);
  wire::ActuatorResponse motor(wire::Actuator::kDcMotor), plain(wire::Actuator::kDcMotor);
  wire::BoardState board = first;
  double reached = 0.0, without = 0.0;
  for (int frame = 1; frame < 30; ++frame) {
    const double drive = wire::drive_of(board[cue.slot]).level;
    ASSERT_LE(drive, 0.9);
    reached = motor.step(drive, 1e-9 * kFrame_ns);
    without = plain.step(level, 1e-9 * kFrame_ns);
    if (frame == 2) {
      EXPECT_GT(reached, 0.9 * level);
      EXPECT_LT(without, 0.65 * level);
    }
    ASSERT_LT(reached, 1.05 * level);
    board = scene.show(mapper, (frame + 1) * kFrame_ns);
  }
  EXPECT_EQ(board[cue.slot], cue.intensity);  // once it runs, what was asked for
}

TEST(TactileMapper, MayLastLongerInsteadOfStronger) {
  for (const auto actuator : {wire::Actuator::kVoiceCoil, wire::Actuator::kDcMotor}) {
    BodyMap map = shipped("arms");
    for (Tactor& tactor : map.tactors) tactor.actuator = actuator;
    double last = 0.0;
    std::uint8_t level = 0;
    for (const double deg : {13.0, 19.0, 25.0, 31.0, 50.0}) {
      TactileMapper mapper(map, {.duration_scaled = true});
      const Scene scene = Scene().ask(Joint::kLeftElbow, degrees(0, deg, 0));
      double on = 0.0;
      for (int ms = 1; ms <= 1000; ++ms) {
        if (is_off(scene.show(mapper, ms * 1'000'000))) continue;
        on += 0.001;
        if (level == 0) level = mapper.cues()[0].intensity;
        ASSERT_EQ(mapper.cues()[0].intensity, level);
        ASSERT_EQ(wire::mode_of_slot(mapper.cues()[0].slot), wire::Mode::kContinuous);
      }
      EXPECT_GE(on, 0.2);
      EXPECT_GT(on, last + 0.1);
      last = on;
    }
    EXPECT_LT(last, 0.9);  // a pause remains
    EXPECT_EQ(TactileMapper(map, {.duration_scaled = true}).cues_given(), 0u);
  }
}

SafeRangeAlarm alarm_at(Joint joint, const Eigen::Vector3d& target, double excess = 0.1) {
  SafeRangeAlarm alarm;
  alarm.target[index(joint)] = target;
  alarm.excess[index(joint)] = excess;
  alarm.any = true;
  return alarm;
}

TEST(TactileMapper, GivesAnAlarmBeforeAnythingElse) {
  const SafeRangeAlarm alarm = alarm_at(Joint::kLeftElbow, degrees(0, 10, 0));
  const Scene busy = Scene()
                         .ask(Joint::kLeftElbow, degrees(0, -40, 0), 0.9)
                         .ask(Joint::kRightElbow, degrees(0, 40, 0), 0.8)
                         .ask(Joint::kRightShoulder, degrees(0, 40, 0), 0.7);
  TactileMapper mapper(shipped("arms"), {.max_cues = 2});
  (void)busy.show(mapper, kFrame_ns);
  ASSERT_EQ(mapper.cues().size(), 2u);
  EXPECT_FALSE(mapper.cues()[0].alarm);
  // In the very next frame, although no cue was felt yet, and against its own joint's correction.
  const auto board =
      mapper.update(2 * kFrame_ns, busy.correction, busy.error, busy.tolerance, true, &alarm);
  ASSERT_EQ(mapper.cues().size(), 2u);
  const auto cue = std::find_if(mapper.cues().begin(), mapper.cues().end(),
                                [](const Cue& c) { return c.alarm; });
  ASSERT_NE(cue, mapper.cues().end());
  EXPECT_EQ(cue->joint, Joint::kLeftElbow);
  EXPECT_FALSE(cue->positive);  // back towards extension
  EXPECT_EQ(wire::mode_of_slot(cue->slot), wire::Mode::kPulsed);
  EXPECT_EQ(board[cue->slot], wire::kStrongestIntensity);
}

TEST(TactileMapper, GivesAnAlarmWithoutAReferenceAndEndsItWhenToldTo) {
  const SafeRangeAlarm alarm = alarm_at(Joint::kLeftElbow, degrees(0, 10, 0)), none;
  const Scene nothing;
  TactileMapper mapper(shipped("arms"), {.max_cues = 0});
  const auto show = [&](std::int64_t stamp, const SafeRangeAlarm* now) {
    return mapper.update(stamp, nothing.correction, nothing.error, nothing.tolerance, false, now);
  };
  EXPECT_FALSE(is_off(show(kFrame_ns, &alarm)));
  EXPECT_FALSE(is_off(show(2 * kFrame_ns, &none)));  // felt first
  EXPECT_TRUE(is_off(show(kFrame_ns + kHold_ns, &none)));
  EXPECT_FALSE(is_off(show(kFrame_ns + 2 * kHold_ns, &alarm)));
  EXPECT_TRUE(is_off(show(2 * kFrame_ns + 2 * kHold_ns, nullptr)));  // a stop: at once
}

TEST(TactileMapper, LetsASiteRestAndMovesOrEndsItsCue) {
  const BodyMap map = shipped("arms");
  ExposureState tired;
  tired.stamp_ns = 1;
  tired.sites[8].heat = kHottest;  // left wrist, front
  const Scene scene = Scene().ask(Joint::kLeftElbow, degrees(0, 30, 0));
  TactileMapper fresh(map), spared(map, {}, tired);
  EXPECT_NE(scene.show(fresh, kFrame_ns)[wire::pulsed_slot(8)] +
                scene.show(fresh, kFrame_ns)[wire::continuous_slot(8)],
            0);
  const auto board = scene.show(spared, kFrame_ns);
  EXPECT_EQ(board[wire::pulsed_slot(8)] + board[wire::continuous_slot(8)], 0);
  tired.sites[8].heat = 0.0;
  tired.sites[8].dose = 1e9;  // the day's dose is used up
  TactileMapper done(map, {}, tired);
  const auto later = scene.show(done, kFrame_ns);
  EXPECT_EQ(later[wire::pulsed_slot(8)] + later[wire::continuous_slot(8)], 0);
}

TEST(TactileMapper, RunsNoSiteHotHoweverLongTheErrorLasts) {
  TactileMapper mapper(shipped("arms"), kEndless);
  // Continuous at nearly full level, the harshest that a correction can ask for, for ten minutes.
  const Scene scene = Scene().ask(Joint::kLeftElbow, degrees(0, 10.0 + 17.9, 0));
  double hottest = 0.0, longest = 0.0;
  for (std::int64_t frame = 1; frame < 37'500; ++frame) {
    (void)scene.show(mapper, frame * kFrame_ns);
    for (const SiteExposure& site : mapper.exposure().sites) {
      hottest = std::max(hottest, site.heat);
      longest = std::max(longest, site.duty);
    }
  }
  EXPECT_LE(hottest, 1.01 * kHottest);
  EXPECT_LE(longest, 1.01 * kLongestDuty);
  EXPECT_GT(longest, 0.9 * kLongestDuty);
}

// The contract of the whole stage, over 20,000 random frames on random maps with random exposure,
// alarms, stops, time stamps and options: rendered as the board does it, with the driver's lapse,
// no tactor is ever driven beyond its ceiling, after its command's lifetime, or while it must rest.
TEST(TactileMapper, NeverDrivesBeyondCeilingLapseOrRest) {
  std::mt19937 generator(11);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> normal(0.0, 0.5);
  const std::vector<std::string> maps{"full_body", "arms", "right_arm", "limbs"};
  std::vector<EnvelopeSample> samples(100);
  for (int trial = 0; trial < 200; ++trial) {
    BodyMap map = shipped(maps[static_cast<std::size_t>(trial) % maps.size()]);
    std::array<double, wire::kTactorCount> ceiling{};
    std::array<wire::Actuator, wire::kTactorCount> actuators{};
    const bool motors = unit(generator) < 0.3;
    ExposureState before;
    before.stamp_ns = 1;
    for (Tactor& tactor : map.tactors) {
      tactor.ceiling = unit(generator);
      tactor.threshold = unit(generator) * tactor.ceiling;
      tactor.angle += normal(generator);
      if (motors && unit(generator) < 0.5) tactor.actuator = wire::Actuator::kDcMotor;
      if (unit(generator) < 0.1) before.sites[tactor.channel].heat = 2.0 * kHottest;
      if (unit(generator) < 0.1) before.sites[tactor.channel].dose = 1e6;
      ceiling[tactor.channel] = tactor.ceiling;
      actuators[tactor.channel] = tactor.actuator;
    }
    TactileMapper mapper(map,
                         {.max_cues = static_cast<std::uint32_t>(5.0 * unit(generator)),
                          .duration_scaled = unit(generator) < 0.5},
                         before);
    std::vector<TimedCommand> commands;
    std::int64_t stamp = 1;
    Scene scene;
    for (int frame = 0; frame < 100; ++frame) {
      stamp += static_cast<std::int64_t>(unit(generator) < 0.05 ? 3e8 * unit(generator)
                                                                : 3.3e7 * unit(generator));
      SafeRangeAlarm alarm;
      for (std::size_t j = 0; j < kJointCount; ++j) {
        const Eigen::Vector3d v(normal(generator), normal(generator), normal(generator));
        if (unit(generator) < 0.1) scene.ask(static_cast<Joint>(j), v, unit(generator));
        if (unit(generator) < 0.02) scene.error[j].x() = std::nan("");
        if (unit(generator) < 0.02) scene.correction.target[j].y() = INFINITY;
        if (unit(generator) < 0.03) alarm = alarm_at(static_cast<Joint>(j), v, unit(generator));
      }
      const bool stopped = unit(generator) < 0.05;
      const auto board =
          mapper.update(stamp, scene.correction, scene.error, scene.tolerance,
                        unit(generator) < 0.9 && !stopped, stopped ? nullptr : &alarm);
      ASSERT_TRUE(!stopped || is_off(board));
      commands.push_back({1e-9 * static_cast<double>(stamp), board, 0.060});
      for (std::size_t c = 0; c < wire::kTactorCount; ++c) {
        ASSERT_TRUE(before.sites[c].dose == 0.0 || mean_drive(board, c).on == 0.0);
        ASSERT_LE(mean_drive(board, c).square, std::max(ceiling[c] * ceiling[c], 0.0) + 1e-12);
      }
    }
    // A stretch of the envelope, and what is after the last command's life.
    const double end = commands.back().time + 0.060;
    for (const double from : {unit(generator) * end, end - 0.06}) {
      render_envelope(commands, actuators, from, 0.0013, samples);
      for (std::size_t i = 0; i < samples.size(); ++i) {
        const bool lapsed = from + 0.0013 * static_cast<double>(i) >= end;
        for (std::size_t c = 0; c < wire::kTactorCount; ++c) {
          ASSERT_LE(samples[i].drive[c], ceiling[c]);
          ASSERT_LE(samples[i].vibration[c], ceiling[c]);
          ASSERT_TRUE(!lapsed || samples[i].drive[c] == 0.0);
        }
      }
    }
  }
}

TEST(TactileMapper, StartsFromAnExposureExactlyWhereAnotherEnded) {
  std::mt19937 generator(12);
  std::normal_distribution<double> normal(0.0, 0.5);
  const BodyMap map = shipped("full_body");
  ExposureState start;
  start.stamp_ns = 5;
  for (SiteExposure& site : start.sites) site = {100.0, 0.5, 9.0};
  TactileMapper first(map, {}, start), second(map, {}, start);
  Scene scene;
  for (int frame = 1; frame < 500; ++frame) {
    scene.ask(static_cast<Joint>(frame % static_cast<int>(kJointCount)),
              {normal(generator), normal(generator), normal(generator)}, 0.5);
    ASSERT_EQ(scene.show(first, frame * kFrame_ns), scene.show(second, frame * kFrame_ns));
  }
  EXPECT_EQ(first.exposure().sites[0].dose, second.exposure().sites[0].dose);
}

}  // namespace
}  // namespace secondskin::coach
