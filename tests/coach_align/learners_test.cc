#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "tests/coach_align/trials.h"

// What learners do that an expert does not: hesitate, begin again, leave out, add, exchange left
// and right, do another technique. Real motions from reference_motions/.
namespace secondskin::coach {
namespace {

// Plays parts of a motion to an aligner, one after the other.
class Learner {
 public:
  Learner(const std::shared_ptr<const Reference>& reference, Motion motion)
      : aligner_(reference), motion_(std::move(motion)) {}

  void play(double from, double to, double tempo = 1.0) {
    for (double x = from; tempo * (to - x) > 0.0; x += tempo / kLearnerRate) show(x);
  }
  void hold(double at, double seconds) {
    for (double t = 0.0; t < seconds; t += 1.0 / kLearnerRate) show(at);
  }
  void show(double x) {
    sample(motion_, x, pose_);
    show(pose_);
    error = std::fabs(now.reference_time - x);
  }
  void show(const Pose& pose) {
    const Phase before = now.phase;
    now = aligner_.update(stamp(time), pose);
    phases.insert(now.phase);
    if (now.phase == Phase::kFinished && before != Phase::kFinished) ++finished;
    time += 1.0 / kLearnerRate;
  }

  AlignmentEstimate now;
  double time = 0.0, error = 0.0;
  std::set<Phase> phases;
  int finished = 0;

 private:
  Aligner aligner_;
  Motion motion_;
  Pose pose_ = Pose(kJointCount);
};

TEST(Learners, WhoHesitateAreFollowedAndCountedOnce) {
  const auto reference = shipped("squat");
  Learner learner(reference, reference->motion);
  learner.hold(0.0, 0.4);
  learner.play(0.0, 0.8);
  for (int i = 0; i < 3; ++i) {  // a little back and on again
    learner.play(0.8, 0.7, -0.5);
    learner.play(0.7, 0.8, 0.5);
  }
  EXPECT_LT(learner.error, 0.1);
  learner.play(0.8, reference->motion.duration());
  learner.hold(reference->motion.duration(), 0.5);
  EXPECT_EQ(learner.finished, 1);
  EXPECT_FALSE(learner.phases.contains(Phase::kLost));
}

TEST(Learners, AtHalfAndDoubleTempoAreFollowed) {
  const auto reference = shipped("low_block");
  for (const double tempo : {0.5, 2.0}) {
    Learner learner(reference, reference->motion);
    learner.hold(0.0, 0.5);
    learner.play(0.0, 2.4, tempo);
    EXPECT_LT(learner.error, 0.06) << tempo;
    EXPECT_NEAR(learner.now.tempo, tempo, 0.25 * tempo);
    learner.play(2.4, reference->motion.duration(), tempo);
    learner.hold(reference->motion.duration(), 0.5);
    EXPECT_EQ(learner.finished, 1) << tempo;
  }
}

TEST(Learners, WhoGoBackToTheMiddleAreFoundThere) {
  const auto reference = shipped("low_block");
  Learner learner(reference, reference->motion);
  learner.hold(0.0, 0.5);
  learner.play(0.0, 2.5);
  learner.play(0.5, 1.0);  // again from before the first block
  EXPECT_LT(learner.error, 0.1);
  learner.play(1.0, reference->motion.duration());
  learner.hold(reference->motion.duration(), 0.5);
  EXPECT_EQ(learner.finished, 1);
}

TEST(Learners, WhoLeaveAPartOutAreFoundBehindIt) {
  const auto reference = shipped("roundhouse_kick");
  Learner learner(reference, reference->motion);
  learner.hold(0.0, 0.3);
  learner.play(0.0, 1.5);
  learner.play(2.3, 2.8);
  EXPECT_LT(learner.error, 0.1);
  learner.play(2.8, reference->motion.duration());
  learner.hold(reference->motion.duration(), 0.5);
  EXPECT_EQ(learner.finished, 1);
}

TEST(Learners, WhoAddAPartAreFollowedBehindIt) {
  const auto reference = shipped("low_block");
  const Motion kick = shipped("roundhouse_kick")->motion;
  Learner learner(reference, reference->motion);
  learner.hold(0.0, 0.5);
  learner.play(0.0, 1.4);
  Pose pose(kJointCount);
  for (double x = 0.4; x < 1.6; x += 1.0 / kLearnerRate) {  // a kick between the two blocks
    sample(kick, x, pose);
    learner.show(pose);
  }
  learner.play(1.4, 2.3);
  EXPECT_LT(learner.error, 0.1);
  learner.play(2.3, reference->motion.duration());
  learner.hold(reference->motion.duration(), 0.5);
  EXPECT_EQ(learner.finished, 1);
}

TEST(Learners, WhoMirrorTheExpertAreFollowedInAMirroredReferenceOnly) {
  const auto reference = shipped("roundhouse_kick");
  const Motion one_kick = slice(reference->motion, 0, 168);  // one side only
  const auto plain = reference_of(one_kick);
  const auto other_side = std::make_shared<const Reference>(mirrored(*plain));
  Motion learner = one_kick;
  for (Pose& pose : learner.poses) pose = secondskin::mirrored(pose);
  const double end = learner.duration();
  Learner followed(other_side, learner), not_followed(plain, learner);
  for (Learner* l : {&followed, &not_followed}) {
    l->hold(0.0, 0.5);
    l->play(0.0, 1.2);
    if (l == &followed) {
      EXPECT_LT(l->error, 0.05);
    }
    l->play(1.2, end);
    l->hold(end, 0.5);
  }
  EXPECT_EQ(followed.finished, 1);
  EXPECT_EQ(not_followed.finished, 0);
}

TEST(Learners, OfAnotherTechniqueAreLostWithinTheirMotion) {
  for (const auto& [name, other] :
       {std::pair{"stepping_punch", "low_block"}, std::pair{"low_block", "stepping_punch"},
        std::pair{"low_block", "knife_hand_block"}}) {
    Learner learner(shipped(name), shipped(other)->motion);
    learner.hold(0.0, 0.5);
    learner.play(0.0, shipped(other)->motion.duration());
    learner.hold(shipped(other)->motion.duration(), 0.5);
    EXPECT_EQ(learner.finished, 0) << other << " followed in " << name;
    EXPECT_FALSE(learner.phases.contains(Phase::kFinished));
  }
}

// Low block, third pair: 10 deg at one moment and 12 at another tell little about where it is.
TEST(Learners, WithAWayOfTheirOwnDoNotLeapBetweenSimilarMoments) {
  const auto reference = shipped("low_block");
  Aligner aligner(reference);
  const Motion learner = resample(shipped_learner("low_block"), kLearnerRate);
  AlignmentEstimate before;
  Pose a(kJointCount), b(kJointCount);
  int leaps = 0;
  for (std::size_t i = 0; i < learner.poses.size(); ++i) {
    const double t = static_cast<double>(i) / kLearnerRate;
    const AlignmentEstimate now = aligner.update(stamp(t), learner.poses[i]);
    const double moved = now.reference_time - before.reference_time;
    const bool followed = now.phase == Phase::kMoving && before.phase == Phase::kMoving;
    if (followed && t < 11.5 && (moved < -0.05 || moved > 0.09)) {
      sample(reference->motion, before.reference_time, a);
      sample(reference->motion, now.reference_time, b);
      if (rms_distance(a, b) > 8.0 * kDegree) ++leaps;
    }
    before = now;
  }
  EXPECT_EQ(leaps, 0);
}

TEST(Learners, AreFollowedInTheMeanOfOtherRepetitions) {
  const Motion whole = shipped_learner("low_block");  // pairs from 0, 4.0 and 7.3 s
  const Motion first = resample(slice(whole, 0, 216), kReferenceRate);
  const std::vector<Motion> experts{shipped("low_block")->motion, first};
  const auto reference =
      std::make_shared<const Reference>(make_reference("two performances", experts));
  EXPECT_EQ(reference->experts, 2U);
  Learner learner(reference, whole);
  learner.play(0.0, whole.duration());
  EXPECT_EQ(learner.finished, 3);
}

}  // namespace
}  // namespace secondskin::coach
