#include "coach/plan/session_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "motion/rotation.h"
#include "tests/coach_align/trials.h"

namespace secondskin::coach {
namespace {

using testing::HasSubstr;
using Kind = FeedbackSchedule::Kind;

std::filesystem::path written(const std::string& text) {
  const auto* test = testing::UnitTest::GetInstance()->current_test_info();
  const auto file = std::filesystem::path(testing::TempDir()) /
                    (std::string("secondskin_plan_") + test->name() + ".toml");
  std::ofstream(file) << text;
  return file;
}

SessionPlan plan_of(const std::string& text, const CueReader& read_cues = {}) {
  return SessionPlan::load(written(text), read_cues);
}

std::string error_of(const std::string& text, const CueReader& read_cues = {}) {
  try {
    (void)plan_of(text, read_cues);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "no error";
}

const std::string kHead = "name = \"p\"\n";
std::string block(const std::string& fields) {
  return "[[block]]\nname = \"b\"\nrepetitions = 3\n" + fields + "\n";
}
const std::string kAlways = "schedule = { kind = \"always\" }";

TEST(SessionPlan, ReadsEveryField) {
  const auto plan = plan_of(
      "name = \"p\"\ndescription = \"d\"\nseed = 9\n" +
      block("tempo = 0.5\ntolerance_scale = 1.5\nmax_cues = 1\nrest_s = 20\n"
            "schedule = { kind = \"fading\", first = 0.8, last = 0.1, with = \"success\", goal = "
            "0.7 }") +
      block("schedule = { kind = \"bandwidth\", band = 2 }") +
      block("schedule = { kind = \"fading_by_joint\", last = 0.25 }") +
      block("schedule = { kind = \"off\" }"));
  EXPECT_EQ(plan.name, "p");
  EXPECT_EQ(plan.seed, 9u);
  ASSERT_EQ(plan.blocks.size(), 4u);
  const Block& first = plan.blocks[0];
  EXPECT_EQ(first.name, "b");
  EXPECT_EQ(first.repetitions, 3u);
  EXPECT_EQ(first.tempo, 0.5);
  EXPECT_EQ(first.tolerance_scale, 1.5);
  EXPECT_EQ(first.max_cues, 1u);
  EXPECT_EQ(first.rest, 20.0);
  EXPECT_EQ(first.schedule.kind, Kind::kFading);
  EXPECT_TRUE(first.schedule.by_success);
  EXPECT_EQ(first.schedule.first, 0.8);
  EXPECT_EQ(first.schedule.last, 0.1);
  EXPECT_EQ(first.schedule.goal, 0.7);
  EXPECT_EQ(plan.blocks[1].schedule.band, 2.0);
  EXPECT_EQ(plan.blocks[1].tempo, 1.0);
  EXPECT_FALSE(plan.blocks[1].tolerance_scale);
  EXPECT_EQ(plan.blocks[2].schedule.kind, Kind::kFadingByJoint);
  EXPECT_EQ(plan.blocks[3].schedule.kind, Kind::kOff);
}

TEST(SessionPlan, NamesFileLineFieldAndExpectation) {
  const auto says = [](const std::string& text, const std::string& line_and_field,
                       const std::string& expectation) {
    const std::string error = error_of(text);
    EXPECT_THAT(error, HasSubstr(".toml:" + line_and_field)) << text;
    EXPECT_THAT(error, HasSubstr(expectation)) << text;
  };
  says(block(kAlways), "1: name", "missing, expected a name");
  says(kHead, "1: block", "one [[block]] at least");
  says(kHead + "blocks = 1\n", "2: blocks", "unknown");
  says(kHead + "[[block]]\nname = \"b\"\n" + kAlways, "2: repetitions",
       "a whole number from 1 to 1000");
  says(kHead + block("tempo = 0.1\n" + kAlways), "5: tempo", "a number from 0.25 to 2");
  says(kHead + block("tempo = nan\n" + kAlways), "5: tempo", "a number from 0.25 to 2");
  says(kHead + block("tolerance_scale = 0\n" + kAlways), "5: tolerance_scale", "0.1 to 10");
  says(kHead + block("max_cues = 0\n" + kAlways), "5: max_cues", "1 to 16");
  says(kHead + block("rest_s = -1\n" + kAlways), "5: rest_s", "0 to 3600");
  says(kHead + block("rest = 1\n" + kAlways), "5: rest", "unknown");
  says(kHead + block(""), "2: schedule", "missing, expected a table");
  says(kHead + block("schedule = { kind = \"sometimes\" }"), "5: kind", "\"fading\"");
  says(kHead + block("schedule = { kind = \"bandwidth\" }"), "5: band", "from 1 to 10");
  says(kHead + block("schedule = { kind = \"always\", band = 2 }"), "5: band", "unknown");
  says(kHead + block("schedule = { kind = \"fading\", first = 0.2, last = 0.5 }"), "5: last",
       "at most first");
  says(kHead + block("schedule = { kind = \"fading\", with = \"luck\" }"), "5: with", "success");
  says(kHead + block("schedule = { kind = \"yoked\" }"), "5: session", "recording");
  EXPECT_THAT(error_of("name = \n"), HasSubstr(".toml:1"));
}

TEST(SessionPlan, AYokedBlockReadsTheCuesOfASessionBesideThePlan) {
  std::filesystem::path asked;
  const CueReader reader = [&](const std::filesystem::path& session) {
    asked = session;
    return std::vector<GivenCue>{{0, 0.1, 0.2, Joint::kLeftElbow, {0.1, 0.0, 0.0}},
                                 {0, 0.4, 0.5, Joint::kRightElbow, {0.1, 0.0, 0.0}}};
  };
  const std::string text =
      kHead + block("schedule = { kind = \"yoked\", session = \"anna.mcap\" }");
  const auto plan = plan_of(text, reader);
  EXPECT_EQ(asked.filename(), "anna.mcap");
  EXPECT_EQ(asked.parent_path(), written(text).parent_path());
  ASSERT_EQ(plan.blocks[0].schedule.cues.size(), 2u);
  EXPECT_EQ(plan.blocks[0].schedule.cues[0].joint, Joint::kLeftElbow);
  const auto sham = plan_of(
      kHead +
          block("schedule = { kind = \"yoked\", session = \"anna.mcap\", random_joints = true }"),
      reader);
  EXPECT_EQ(sham.blocks[0].schedule.cues[0].joint, Joint::kRightElbow);
  EXPECT_THAT(error_of(text,
                       [](const auto&) -> std::vector<GivenCue> {
                         throw std::runtime_error("no such file");
                       }),
              HasSubstr(":5: session: expected the recording of a coached session, but no such"));
  EXPECT_THAT(error_of(text, [](const auto&) { return std::vector<GivenCue>(kMostYokedCues + 1); }),
              HasSubstr("at most 256 cues in a repetition"));
}

TEST(SessionPlan, EveryShippedPlanIsValidAndEndsWithoutCues) {
  std::size_t found = 0;
  for (const auto& entry : std::filesystem::directory_iterator(SECONDSKIN_SOURCE_DIR "/plans")) {
    const auto plan = SessionPlan::load(entry.path(), {});
    EXPECT_EQ(plan.name, entry.path().stem());
    EXPECT_FALSE(plan.description.empty());
    EXPECT_EQ(plan.blocks.back().schedule.kind, Kind::kOff) << plan.name;
    ++found;
  }
  EXPECT_GE(found, 3u);
}

TEST(AtTempo, KeepsEveryPoseBandAndPostureAtItsNewTime) {
  const auto reference = shipped("deep_squat");
  ASSERT_FALSE(reference->band.empty());
  for (const double tempo : {0.25, 0.5, 0.75, 1.5}) {
    const auto slowed = at_tempo(reference, tempo);
    EXPECT_EQ(slowed->motion.rate_hz, reference->motion.rate_hz);
    EXPECT_NEAR(slowed->motion.duration(), reference->motion.duration() / tempo, 1.0 / 60.0);
    const std::size_t frames = slowed->motion.poses.size();
    EXPECT_EQ(slowed->band.size(), frames);
    ASSERT_EQ(slowed->posture.mean.size(), frames);
    ASSERT_EQ(slowed->posture.spread.size(), frames);
    ASSERT_EQ(slowed->posture.spread_from_start.size(), frames);
    for (std::size_t f = 0; f < kPostureCount; ++f) {
      EXPECT_DOUBLE_EQ(slowed->posture.mean.front()[f], reference->posture.mean.front()[f]);
      EXPECT_DOUBLE_EQ(slowed->posture.mean.back()[f], reference->posture.mean.back()[f]);
      EXPECT_NEAR(slowed->posture.mean[frames / 2][f],
                  reference->posture.mean[reference->posture.mean.size() / 2][f], 3.0 * kDegree);
    }
    Pose there(kJointCount), here(kJointCount);
    for (double time = 0.0; time < reference->motion.duration(); time += 0.013) {
      sample(reference->motion, time, there);
      sample(slowed->motion, time / tempo, here);
      EXPECT_LT(rms_distance(there, here), (tempo <= 1.0 ? 0.1 : 0.5) * kDegree);
      EXPECT_NEAR(slowed->tolerance_at(time / tempo, index(Joint::kLeftKnee)),
                  reference->tolerance_at(time, index(Joint::kLeftKnee)), 1.0 * kDegree);
    }
  }
  EXPECT_EQ(at_tempo(reference, 1.0), reference);
}

RepetitionScore done_well(double in_band) {
  RepetitionScore score;
  for (auto& joint : score.joints) joint.in_band = in_band;
  return score;
}

TEST(PlanProgress, GoesThroughTheBlocksAndRestsBetweenThem) {
  using Step = PlanProgress::Step;
  const auto plan =
      plan_of(kHead + block("rest_s = 2\nschedule = { kind = \"off\" }") + block(kAlways));
  std::array<double, kJointCount> weight;
  weight.fill(1.0);
  PlanProgress progress(plan, weight);
  EXPECT_TRUE(progress.feedback().joints.none());
  EXPECT_EQ(progress.repetition(done_well(1.0), 10), Step::kNone);
  EXPECT_EQ(progress.repetition(done_well(1.0), 20), Step::kNone);
  EXPECT_FALSE(progress.resting());
  EXPECT_EQ(progress.repetition(done_well(1.0), 30), Step::kBlockBegins);
  EXPECT_EQ(progress.block_index(), 1u);
  EXPECT_EQ(progress.repetitions(), 0u);
  EXPECT_TRUE(progress.resting());
  EXPECT_FALSE(progress.advance(2'000'000'029));
  EXPECT_TRUE(progress.advance(2'000'000'030));
  EXPECT_FALSE(progress.resting());
  EXPECT_FALSE(progress.advance(2'000'000'031)) << "said once";
  EXPECT_TRUE(progress.feedback().joints.all());
  (void)progress.repetition(done_well(1.0), 40);
  (void)progress.repetition(done_well(1.0), 50);
  EXPECT_EQ(progress.repetition(done_well(1.0), 60), Step::kEnded);
  EXPECT_TRUE(progress.ended());
}

TEST(PlanProgress, WithoutAPlanCuesForEver) {
  std::array<double, kJointCount> weight;
  weight.fill(1.0);
  PlanProgress progress(SessionPlan::open(), weight);
  for (int n = 0; n < 200; ++n) {
    EXPECT_TRUE(progress.feedback().joints.all());
    EXPECT_EQ(progress.repetition(done_well(1.0), n), PlanProgress::Step::kNone);
  }
}

}  // namespace
}  // namespace secondskin::coach
