#include "clients/authoring/draft.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "clients/authoring/save.h"
#include "clients/authoring/take.h"
#include "tests/authoring/bench.h"

namespace secondskin::authoring {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::size_t kElbow = index(Joint::kLeftElbow);
constexpr std::size_t kShoulder = index(Joint::kLeftShoulder);

Motion once(double seconds, double elbow) {
  std::vector<double> way;
  raise(way, seconds, 60.0);
  way.push_back(0.0);
  return arms(way, 60.0, elbow);
}

class Drafts : public OwnFolder {
 protected:
  const JointMap map_ = canonical_names(kJointMaps);
};

TEST_F(Drafts, OfOnePartHasDefaultTolerances) {
  const Motion part = once(2.0, 0.3);
  const Draft draft = make_draft({&part, 1}, {}, map_);
  EXPECT_NEAR(draft.mean.duration(), 2.0, 0.05);
  for (const auto& joint : draft.joints) EXPECT_EQ(joint.spread, 0.0);
  EXPECT_NEAR(draft.joints[kElbow].tolerance, coach::kDefaultTolerance_deg * kDegree, 1e-9);
  EXPECT_NEAR(draft.joints[index(Joint::kLeftWrist)].tolerance, 20.0 * kDegree, 1e-9);
  EXPECT_TRUE(draft.standing);
}

TEST_F(Drafts, GiveAJointThatVariesTheWiderTolerance) {
  const std::vector<Motion> parts{once(2.0, 0.2), once(2.2, 0.6), once(1.9, 1.0)};
  const Draft draft = make_draft(parts, {}, map_);
  // Equation 4: s^2 is the mean over time of the elbows' variance: 0.4 rad apart times the way up,
  // whose mean square is 3/8.
  EXPECT_NEAR(draft.joints[kElbow].spread, 0.4 * std::sqrt(3.0 / 8.0), 0.02);
  const double expected = std::hypot(6.0 * kDegree, 2.0 * 1.25 * draft.joints[kElbow].spread);
  EXPECT_NEAR(draft.joints[kElbow].tolerance, std::min(expected, 40.0 * kDegree), 1.0 * kDegree);
  // All raise the arms alike; what is left is warping three tempos onto each other.
  EXPECT_LE(draft.joints[kShoulder].tolerance, coach::kDefaultTolerance_deg * kDegree);
  EXPECT_NEAR(draft.mean.duration(), (2.0 + 2.2 + 1.9) / 3.0, 0.1);
}

TEST_F(Drafts, FindTheJointsThatMove) {
  const std::vector<Motion> parts{once(2.0, 0.3), once(2.2, 0.3)};
  const Draft draft = make_draft(parts, {}, map_);
  EXPECT_GE(draft.joints[kShoulder].weight, kOfInterest);
  EXPECT_LT(draft.joints[index(Joint::kLeftKnee)].weight, kOfInterest);
  EXPECT_NEAR(draft.joints[kShoulder].range, 1.5, 0.1);
}

TEST_F(Drafts, WeighNothingWhatWasNotMeasured) {
  Motion part = once(2.0, 0.3);
  for (Pose& pose : part.poses) pose.confidence[index(Joint::kHead)] = 0.0F;
  const Draft draft = make_draft({&part, 1}, {}, map_);
  EXPECT_FALSE(draft.joints[index(Joint::kHead)].measured);
  EXPECT_EQ(draft.joints[index(Joint::kHead)].weight, 0.0);
}

TEST_F(Drafts, SayWhenEachPartIsWhereTheMeanIs) {
  const std::vector<Motion> parts{once(1.5, 0.3), once(3.0, 0.3)};
  const Draft draft = make_draft(parts, {}, map_);
  ASSERT_EQ(draft.when.size(), 2U);
  for (std::size_t p = 0; p < 2; ++p) {
    ASSERT_EQ(draft.when[p].size(), draft.mean.poses.size());
    EXPECT_TRUE(std::is_sorted(draft.when[p].begin(), draft.when[p].end()));
    EXPECT_NEAR(draft.when[p].front(), 0.0, 1e-9);
    EXPECT_NEAR(draft.when[p].back(), parts[p].duration(), 0.05);
    // Half way up is half way up in all.
    EXPECT_NEAR(draft.when[p][draft.when[p].size() / 2], parts[p].duration() / 2.0, 0.15);
  }
}

// What was looked at is what the coach loads: to the six decimals of a file's degrees.
TEST_F(Drafts, AreWhatTheCoachLoadsOnceSaved) {
  const Motion take = shipped("deep_squat", "learner.bvh");
  std::vector<Motion> parts;
  for (const Span& span : cut(take).repetitions) parts.push_back(part_of(take, span, "part"));
  ASSERT_EQ(parts.size(), 3U);
  const Draft draft = make_draft(parts, {}, map_);
  Recipe recipe = plain_recipe("mine", parts);
  recipe.standing = draft.standing;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    recipe.weight[j] = draft.joints[j].weight;
    recipe.tolerance[j] = draft.joints[j].tolerance;
  }
  const auto reference =
      coach::load_reference(save_reference(recipe, folder_, kJointMaps), kJointMaps);
  EXPECT_EQ(reference.experts, 3U);
  EXPECT_EQ(reference.standing, draft.standing);
  ASSERT_EQ(reference.motion.poses.size(), draft.mean.poses.size());
  for (std::size_t i = 0; i < draft.mean.poses.size(); ++i) {
    for (std::size_t j = 0; j < kJointCount; ++j) {
      EXPECT_LT(geodesic_distance(reference.motion.poses[i].q_PB[j], draft.mean.poses[i].q_PB[j]),
                1e-6)
          << i << " " << joint_name(static_cast<Joint>(j));
    }
    EXPECT_LT((reference.motion.poses[i].p_WR - draft.mean.poses[i].p_WR).norm(), 1e-6);
  }
  for (std::size_t j = 0; j < kJointCount; ++j) {
    EXPECT_NEAR(reference.weight[j], draft.joints[j].weight, 1e-9);
    EXPECT_NEAR(reference.tolerance[j], draft.joints[j].tolerance, 1e-9);
  }
}

// The mean of a draft is nearer to the parts than they are to each other.
TEST_F(Drafts, AverageRealRepetitions) {
  const Motion take = shipped("low_block", "learner.bvh");
  std::vector<Motion> parts;
  for (const Span& span : cut(take).repetitions) parts.push_back(part_of(take, span, "part"));
  const Draft draft = make_draft(parts, {}, map_);
  EXPECT_FALSE(draft.joints[kElbow].weight < kOfInterest);
  EXPECT_FALSE(draft.standing);  // he steps
  for (const auto& joint : draft.joints) {
    EXPECT_GE(joint.tolerance, 6.0 * kDegree - 1e-9);
    EXPECT_LE(joint.tolerance, 40.0 * kDegree + 1e-9);
  }
}

TEST_F(Drafts, NeedAPart) { EXPECT_THROW(make_draft({}, {}, map_), std::invalid_argument); }

}  // namespace
}  // namespace secondskin::authoring
