#include "coach/reference.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "motion/bvh.h"
#include "tests/coach_align/trials.h"

namespace secondskin::coach {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

class ReferenceFolder : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("secondskin_reference_" + std::to_string(::getpid()));
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    fs::copy(kReferences / "squat" / "motion.bvh", folder_ / "motion.bvh");
  }
  void TearDown() override { fs::remove_all(folder_); }

  Reference load(const std::string& toml) {
    std::ofstream(folder_ / "motion.toml") << toml;
    return load_reference(folder_, kJointMaps);
  }
  std::string complaint(const std::string& toml) {
    try {
      load(toml);
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "no complaint";
  }

  fs::path folder_;
};

TEST(ReferenceMotions, AllLoadWithTheirOriginAndLicence) {
  int references = 0;
  for (const auto& entry : fs::directory_iterator(kReferences)) {
    if (!entry.is_directory()) continue;
    const Reference r = load_reference(entry.path(), kJointMaps);
    EXPECT_EQ(r.name, entry.path().filename());
    EXPECT_FALSE(r.description.empty());
    EXPECT_FALSE(r.origin.empty());
    EXPECT_FALSE(r.licence.empty());
    EXPECT_TRUE(fs::exists(entry.path() / "LICENCE.txt"));
    EXPECT_TRUE(fs::exists(entry.path() / "learner.bvh"));
    EXPECT_EQ(r.motion.rate_hz, kReferenceRate);
    EXPECT_TRUE(is_canonical(r.motion.skeleton));
    EXPECT_GT(r.motion.duration(), 1.0);
    EXPECT_LT(r.motion.duration(), 10.0);
    ++references;
  }
  EXPECT_GE(references, 5);
}

TEST_F(ReferenceFolder, GivesDefaultsToWhatIsNotNamed) {
  const Reference r =
      load("[weights]\ndefault = 0.5\nleft_knee = 1\n[tolerances_deg]\nhead = 25.0\n");
  EXPECT_EQ(r.name, folder_.filename());
  EXPECT_DOUBLE_EQ(r.weight[index(Joint::kLeftKnee)], 1.0);
  EXPECT_DOUBLE_EQ(r.weight[index(Joint::kRightKnee)], 0.5);
  EXPECT_DOUBLE_EQ(r.tolerance[index(Joint::kHead)], 25.0 * kDegree);
  EXPECT_DOUBLE_EQ(r.tolerance[index(Joint::kNeck)], kDefaultTolerance_deg * kDegree);
  EXPECT_FALSE(r.standing);
}

TEST_F(ReferenceFolder, ClipsToTheTimesAskedFor) {
  const Reference whole = load("");
  const Reference part = load("[clip]\nstart = 0.5\nend = 1.25\n");
  EXPECT_NEAR(part.motion.duration(), 0.75, 1e-9);
  EXPECT_LT(rms_distance(part.motion.poses.front(), whole.motion.poses[30]), 1e-6);
}

TEST_F(ReferenceFolder, SaysFileLineFieldAndWhatWasExpected) {
  EXPECT_THAT(complaint("name = 3\n"),
              AllOf(HasSubstr("motion.toml:1"), HasSubstr("name"), HasSubstr("text")));
  EXPECT_THAT(complaint("name = \"a\"\nnonsense = 1\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("nonsense"), HasSubstr("one of")));
  EXPECT_THAT(complaint("\n[weights]\nleft_kne = 1\n"),
              AllOf(HasSubstr("motion.toml:3"), HasSubstr("left_kne"), HasSubstr("joint")));
  EXPECT_THAT(complaint("[weights]\nhead = 2.0\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("weights.head"), HasSubstr("0 to 1")));
  EXPECT_THAT(complaint("[weights]\ndefault = 0\n"),
              AllOf(HasSubstr("motion.toml:1"), HasSubstr("at least one joint")));
  EXPECT_THAT(complaint("[tolerances_deg]\nhead = nan\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("tolerances_deg.head")));
  EXPECT_THAT(complaint("standing = \"yes\"\n"),
              AllOf(HasSubstr("motion.toml:1"), HasSubstr("true or false")));
  EXPECT_THAT(complaint("[clip]\nstart = 1.0\nend = 0.5\n"),
              AllOf(HasSubstr("clip"), HasSubstr("start before end")));
  EXPECT_THAT(complaint("[clip]\nend = 99.0\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("clip.end")));
  EXPECT_THAT(complaint("weights = 1\n"), AllOf(HasSubstr("motion.toml:1"), HasSubstr("table")));
  EXPECT_THAT(complaint("name = \"torn\n"), HasSubstr("motion.toml:1"));
}

TEST_F(ReferenceFolder, MissesWhatIsNotThere) {
  EXPECT_THROW(load_reference(folder_, kJointMaps), std::runtime_error);  // no motion.toml
  EXPECT_THROW(load_reference(folder_ / "nothing", kJointMaps), std::runtime_error);
}

TEST_F(ReferenceFolder, TakesAMotionFileAlone) {
  const Reference r = load_reference(folder_ / "motion.bvh", kJointMaps);
  EXPECT_EQ(r.name, "motion");
  for (const double w : r.weight) EXPECT_EQ(w, 1.0);
}

TEST(MakeReference, ResamplesAndRefusesOtherSkeletons) {
  Motion motion{canonical_skeleton(), 30.0, std::vector<Pose>(31, Pose(kJointCount))};
  EXPECT_EQ(make_reference("a", motion).motion.poses.size(), 61U);
  const Motion stick{Skeleton({Segment{.name = "stick", .parent = std::nullopt}}), 60.0,
                     std::vector<Pose>(2, Pose(1))};
  EXPECT_THROW(make_reference("b", stick), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::coach
