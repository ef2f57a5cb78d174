#include <gtest/gtest.h>

#include "coach/coach.h"
#include "coach/correct/simulated_source.h"
#include "coach/plan/cue_log.h"
#include "tests/coach_align/trials.h"

// The coach under a schedule: what is cued changes, what is followed and scored does not.

namespace secondskin::coach {
namespace {

BodyMap arms() { return BodyMap::load(SECONDSKIN_SOURCE_DIR "/body_maps/arms.toml"); }

struct Session {
  std::vector<wire::BoardState> boards;
  std::vector<double> reference_times;
  std::vector<double> shares;
  std::vector<RepetitionScore> repetitions;
  std::uint64_t cues = 0;
  std::array<std::uint64_t, kJointCount> cues_by_joint{};
  std::vector<GivenCue> given;

  std::size_t frames_on() const {
    return static_cast<std::size_t>(std::count_if(
        boards.begin(), boards.end(), [](const auto& b) { return b != wire::BoardState{}; }));
  }
};

Session session(const Motion& learner, const Feedback& feedback, const TactileSetup& tactile = {},
                bool resting = false) {
  const auto reference = shipped("low_block");
  const CoachSettings settings{.tolerance_scale = 0.3, .max_cues = 2};
  SimulatedSource source(reference, learner.skeleton,
                         {.tolerance_scale = settings.tolerance_scale});
  Coach coach(reference, arms(), settings, source, tactile);
  coach.feedback(feedback);
  coach.rest(resting);
  Session result;
  CoachOutput out;
  CueLog log;
  std::uint64_t frame = 0;
  for (const Pose& pose : learner.poses) {
    ++frame;
    coach.step({frame, stamp(static_cast<double>(frame) / learner.rate_hz), pose}, out);
    coach.pose_problem();
    result.boards.push_back(out.tactors);
    result.reference_times.push_back(out.alignment.reference_time);
    result.shares.push_back(out.alignment.reference_time / reference->motion.duration());
    log.take(0, result.shares.back(), coach.cues(), out.correction, out.error, coach.tolerance());
    if (out.repetition) result.repetitions.push_back(*out.repetition);
  }
  result.cues = coach.cues_given();
  result.cues_by_joint = coach.cues_by_joint();
  result.given = log.cues();
  return result;
}

Feedback off() {
  Feedback feedback;
  feedback.joints.reset();
  return feedback;
}

TEST(CoachFeedback, OffNeverCuesAndFollowsAndScoresAllTheSame) {
  const Motion learner = shipped_learner("low_block");
  const Session always = session(learner, {}), never = session(learner, off());
  EXPECT_GT(always.frames_on(), learner.poses.size() / 4);
  EXPECT_EQ(never.frames_on(), 0u);
  EXPECT_EQ(never.cues, 0u);
  EXPECT_EQ(never.reference_times, always.reference_times);
  ASSERT_EQ(never.repetitions.size(), always.repetitions.size());
  ASSERT_GE(never.repetitions.size(), 2u);
  for (std::size_t i = 0; i < never.repetitions.size(); ++i) {
    EXPECT_EQ(never.repetitions[i].total, always.repetitions[i].total);
  }
}

TEST(CoachFeedback, AWiderBandCuesLess) {
  const Motion learner = shipped_learner("low_block");
  std::vector<std::size_t> on;
  // Far enough apart that it does not matter when the pauses between cues come.
  for (const double band : {1.0, 4.0, 8.0, 40.0}) {
    Feedback feedback;
    feedback.band = band;
    on.push_back(session(learner, feedback).frames_on());
    if (on.size() > 1) {
      EXPECT_LT(on.back(), on[on.size() - 2]) << band;
    }
  }
  EXPECT_EQ(on.back(), 0u);
}

TEST(CoachFeedback, AJointThatIsLeftOutIsNeverCuedAndTheOthersAre) {
  const Motion learner = shipped_learner("low_block");
  const Session all = session(learner, {});
  const auto most = static_cast<std::size_t>(
      std::max_element(all.cues_by_joint.begin(), all.cues_by_joint.end()) -
      all.cues_by_joint.begin());
  Feedback feedback;
  feedback.joints.reset(most);
  const Session rest = session(learner, feedback);
  EXPECT_EQ(rest.cues_by_joint[most], 0u);
  EXPECT_GT(rest.cues, 0u);
}

TEST(CoachFeedback, YokedCuesComeWhateverTheOwnErrorIs) {
  const Motion learner = shipped_learner("low_block");
  Feedback yoked;
  yoked.yoked = true;
  yoked.cues = {{0, 0.3, 0.5, Joint::kRightElbow, {0.0, -0.3, 0.0}}};
  // The reference itself has no error at all; the same moves with another bent elbow have one.
  const Motion expert = shipped("low_block")->motion;
  Motion bent = expert;
  for (Pose& pose : bent.poses) {
    auto& elbow = pose.q_PB[index(Joint::kLeftElbow)];
    elbow = elbow * quaternion_from({0.0, 0.2, 0.0});
  }
  const Session without = session(expert, yoked), with = session(bent, yoked);
  EXPECT_EQ(session(expert, {}).frames_on(), 0u);
  EXPECT_GT(session(bent, {}).cues_by_joint[index(Joint::kLeftElbow)], 0u);
  for (const Session* one : {&without, &with}) {
    EXPECT_GT(one->frames_on(), 10u);
    EXPECT_EQ(one->cues, one->cues_by_joint[index(Joint::kRightElbow)]);
    for (std::size_t i = 0; i < one->boards.size(); ++i) {
      if (one->boards[i] == wire::BoardState{}) continue;
      EXPECT_GE(one->shares[i], 0.3 - 0.02);
      // A cue is held until it was felt.
      EXPECT_LE(one->shares[i], 0.5 + 0.1);
    }
  }
}

TEST(CoachFeedback, ARecordedSessionsCuesYokedToTheSameLearnerAreFeltAtTheSameTimes) {
  Motion learner = shipped_learner("low_block");
  learner = slice(learner, 0, 250);
  const Session own = session(learner, {});
  Feedback yoked;
  yoked.yoked = true;
  yoked.cues = own.given;
  ASSERT_GT(yoked.cues.size(), 2u);
  const Session other = session(learner, yoked);
  std::size_t equal = 0;
  for (std::size_t i = 0; i < own.boards.size(); ++i) {
    equal += (own.boards[i] != wire::BoardState{}) == (other.boards[i] != wire::BoardState{});
  }
  EXPECT_GT(equal, own.boards.size() * 8 / 10);
}

TEST(CoachFeedback, NeitherOffNorRestSilencesTheSafeRange) {
  const Motion learner = shipped_learner("low_block");
  TactileSetup tactile;
  tactile.safe_range.limits.push_back(
      {Joint::kRightElbow, Movement::kFlexion, -0.1, 10.0 * kDegree});
  tactile.safe_range.limits.push_back(
      {Joint::kLeftElbow, Movement::kFlexion, -0.1, 10.0 * kDegree});
  EXPECT_GT(session(learner, off(), tactile).frames_on(), 20u);
  const Session resting = session(learner, off(), tactile, true);
  EXPECT_GT(resting.frames_on(), 20u);
  EXPECT_TRUE(resting.repetitions.empty());
  EXPECT_EQ(session(learner, {}, {}, true).frames_on(), 0u);
}

}  // namespace
}  // namespace secondskin::coach
