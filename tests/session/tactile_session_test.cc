#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "session.h"

namespace secondskin::session {
namespace {

/// Where the next process reads its answers.
std::string answers_file;

void read_answers() {
  const int in = ::open(answers_file.c_str(), O_RDONLY);
  ::dup2(in, 0);
}

std::string lines(const std::string& word, int count) {
  std::string text;
  for (int i = 0; i < count; ++i) text += word + "\n";
  return text;
}

/// Two tactors on one forearm, allowed 0.6 of full drive.
std::string write_map(const Session& session) {
  const std::string file = session.folder / "pair.toml";
  std::ofstream out(file);
  out << "name = \"pair\"\ncue = \"repulsive\"\n";
  for (const int channel : {0, 2}) {
    out << "[[tactor]]\nchannel = " << channel << "\nsegment = \"right_elbow\"\nalong = 0.9\n"
        << "angle_deg = " << 90 * channel << "\nactuator = \"voice_coil\"\nthreshold = 0.3\n"
        << "ceiling = 0.6\n";
  }
  return file;
}

/// Where the program keeps profiles, in the session's folder instead of the user's.
std::filesystem::path own_profiles(const Session& session) {
  const auto data = std::filesystem::path(session.folder / "data");
  ::setenv("XDG_DATA_HOME", data.c_str(), 1);
  return data / "secondskin" / "learners";
}

/// A new learner of the history in own_profiles()'s folder.
std::string add_learner(const Session& session) {
  Process add = session.start("add", {"history", "add", "--json"});
  EXPECT_TRUE(add.wait(20s));
  const std::string output = add.output();
  return nlohmann::json::parse(output.substr(output.find("{\n")))["id"];
}

std::vector<std::string> calibration(const Session& session, const std::string& map,
                                     const std::string& learner) {
  return session.on_bus({"calibrate", "tactors", "--port", session.port(), "--body-map", map,
                         "--duration", "0.05", "--presentations", "3", "--learner", learner,
                         "--json"});
}

/// A profile as calibration writes it, of five of the full body's tactors.
void write_profile(const std::filesystem::path& file) {
  std::filesystem::create_directories(file.parent_path());
  std::ofstream out(file);
  out << "body_map = \"full_body\"\n";
  for (const int channel : {0, 1, 2, 3, 8}) {
    out << "[[site]]\nchannel = " << channel << "\nthreshold = 0.4\nceiling = 0.7\nnamed = [";
    for (int c = 0; c < 16; ++c) out << (c == channel ? 4 : 0) << (c < 15 ? ", " : "]\n");
  }
}

TEST(CalibrateTactors, MeasuresByTheLearnersAnswersWithinTheMapsCeiling) {
  const Session session;
  const auto profiles = own_profiles(session);
  const std::string learner = add_learner(session), map = write_map(session);
  const Process board = session.board();
  ASSERT_TRUE(eventually([&] { return std::filesystem::exists(session.waveform()); }, 10s));
  answers_file = session.folder / "answers";
  // Feels everything, finds nothing too strong, and takes everything for the front one. Letters
  // that answer another question are passed over.
  std::ofstream(answers_file) << lines("y", 40) << lines("g", 20) << lines("y", 40)
                              << lines("g", 20) << lines("0", 6);
  Process calibrate = session.start("calibrate", calibration(session, map, learner), read_answers);
  ASSERT_TRUE(calibrate.wait(60s));
  ASSERT_EQ(calibrate.exit_code(), 0) << calibrate.output();
  const std::string output = calibrate.output();
  const auto result = nlohmann::json::parse(output.substr(output.find("{\n")));
  ASSERT_EQ(result["sites"].size(), 2u);
  EXPECT_NEAR(result["sites"][0]["threshold"].get<double>(), 0.3, 1e-9);
  EXPECT_NEAR(result["sites"][0]["ceiling"].get<double>(), 0.6, 1e-9);
  EXPECT_EQ(result["sites"][0]["recognition"], 1.0);
  EXPECT_EQ(result["sites"][1]["recognition"], 0.0);
  EXPECT_EQ(result["sites"][1]["named"][0], 3);
  EXPECT_NE(read_text(profiles / (learner + ".toml")).find("[[site]]"), std::string::npos);

  const auto rows = read_waveform(session.waveform());
  double strongest = 0.0;
  for (const auto& row : rows) strongest = std::max(strongest, row.strongest);
  EXPECT_GT(strongest, 0.55);
  EXPECT_LE(strongest, 0.6);
  EXPECT_FALSE(session.tactors_are_on());
}

TEST(CalibrateTactors, KeepsNothingAndLeavesNothingOnWhenItIsEndedEarly) {
  const Session session;
  const auto profiles = own_profiles(session);
  const std::string learner = add_learner(session), map = write_map(session);
  const Process board = session.board();
  ASSERT_TRUE(eventually([&] { return std::filesystem::exists(session.waveform()); }, 10s));
  answers_file = session.folder / "answers";
  for (const std::string& end : {std::string(), std::string("q\n")}) {
    std::ofstream(answers_file) << "y\ny\n" << end;
    Process calibrate =
        session.start("calibrate", calibration(session, map, learner), read_answers);
    ASSERT_TRUE(calibrate.wait(30s));
    EXPECT_NE(calibrate.exit_code(), 0);
    EXPECT_TRUE(calibrate.says("nothing was saved")) << calibrate.output();
    EXPECT_FALSE(std::filesystem::exists(profiles / (learner + ".toml")));
    EXPECT_TRUE(eventually([&] { return !session.tactors_are_on(); }, 2s));
  }
}

// One that no deletion would find.
TEST(CalibrateTactors, RefusesALearnerWhomTheHistoryDoesNotKnow) {
  const Session session;
  const auto profiles = own_profiles(session);
  const std::string map = write_map(session), learner = add_learner(session);
  for (const std::string other : {"L-0000000", "../anna"}) {
    Process calibrate = session.start("calibrate", calibration(session, map, other));
    ASSERT_TRUE(calibrate.wait(20s));
    EXPECT_NE(calibrate.exit_code(), 0);
    EXPECT_TRUE(calibrate.says("--learner '" + other + "'")) << calibrate.output();
    EXPECT_FALSE(std::filesystem::exists(profiles));
  }
}

TEST(CalibrateTactors, RefusesAFileThatCannotBeWrittenBeforeAnybodyAnswers) {
  const Session session;
  Process calibrate =
      session.start("calibrate", {"calibrate", "tactors", "--out", "/proc/none/anna.toml"});
  ASSERT_TRUE(calibrate.wait(20s));
  EXPECT_NE(calibrate.exit_code(), 0);
  EXPECT_TRUE(calibrate.says("--out /proc/none/anna.toml")) << calibrate.output();
  EXPECT_FALSE(calibrate.says("did you feel it")) << calibrate.output();
}

// A session that the learner's profile, a safe range and yesterday's habits shape is replayed from
// its recording alone, bit for bit, and what the skin bore is there for the next one.
TEST(TactileSession, IsReplayedWithTheLearnersProfileRangeAndExposure) {
  const Session session;
  const auto profiles = own_profiles(session);
  const std::string range = session.folder / "range.toml";
  write_profile(profiles / "L-7K3M9Q.toml");
  std::ofstream(range) << "[limits_deg.right_elbow]\nflexion = [-10, 30]\n"
                          "[limits_deg.left_elbow]\nflexion = [-10, 30]\n";
  std::string last;
  for (const bool scaled : {false, true}) {
    const std::string recording = session.folder / (scaled ? "second.mcap" : "first.mcap");
    std::vector<std::string> train{"train",   "--reference",       "low_block", "--recording",
                                   recording, "--learner-profile", "L-7K3M9Q",  "--safe-range",
                                   range,     "--tolerance-scale", "0.3"};
    if (scaled) train.push_back("--duration-scaled");
    Process run = session.start("train", session.on_bus(train));
    ASSERT_TRUE(run.wait(90s));
    ASSERT_EQ(run.exit_code(), 0) << run.output();
    // Neither file is needed any more.
    Process replay = session.start("replay", {"replay", recording, "--coach", "--json"});
    ASSERT_TRUE(replay.wait(90s));
    EXPECT_EQ(replay.exit_code(), 0) << replay.output();
    const std::string output = replay.output();
    const auto result = nlohmann::json::parse(output.substr(output.find("{\n")));
    EXPECT_GT(result["commands_compared"].get<int>(), 100);
    EXPECT_EQ(result["commands_different"], 0) << output;
    const std::string exposure = read_text(profiles / "L-7K3M9Q.exposure.toml");
    EXPECT_NE(exposure.find("right_elbow"), std::string::npos);
    EXPECT_NE(exposure, last);
    last = exposure;
  }
}

TEST(TactileSession, KeepsNothingOfALearnerWhoWasDeletedMeanwhile) {
  const Session session;
  const auto profiles = own_profiles(session);
  const std::string learner = add_learner(session);
  write_profile(profiles / (learner + ".toml"));
  Process run =
      session.start("train", session.on_bus({"train", "--reference", "low_block", "--recording",
                                             session.folder / "session.mcap", "--learner-profile",
                                             learner, "--loop", "--dashboard-port", "0"}));
  ASSERT_TRUE(
      eventually([&] { return std::filesystem::exists(session.folder / "session.mcap"); }, 20s));
  Process remove = session.start("delete", {"history", "delete", learner, "--yes"});
  ASSERT_TRUE(remove.wait(20s));
  ASSERT_EQ(remove.exit_code(), 0) << remove.output();
  run.end(SIGTERM);
  ASSERT_TRUE(run.wait(30s));
  EXPECT_EQ(run.exit_code(), 0) << run.output();
  EXPECT_TRUE(run.says("deleted during the session")) << run.output();
  EXPECT_TRUE(std::filesystem::is_empty(profiles));
}

TEST(TactileSession, NamesLimitsThatTheMapCannotSay) {
  const Session session;
  const std::string range = session.folder / "range.toml", map = write_map(session);
  std::ofstream(range) << "[limits_deg.left_knee]\nflexion = [0, 90]\n";
  Process coach =
      session.start("coach", session.on_bus({"coach", "--reference", "squat", "--body-map", map,
                                             "--safe-range", range, "--wait"}));
  EXPECT_TRUE(eventually([&] { return coach.says("left_knee flexion to 90 degrees"); }, 10s));
  std::ofstream(range) << "[limits_deg.left_knee]\nflexion = [90, 0]\n";
  Process wrong = session.start(
      "wrong", session.on_bus({"coach", "--reference", "squat", "--safe-range", range}));
  ASSERT_TRUE(wrong.wait(10s));
  EXPECT_NE(wrong.exit_code(), 0);
  EXPECT_TRUE(wrong.says("range.toml:2: flexion: expected two numbers")) << wrong.output();
}

}  // namespace
}  // namespace secondskin::session
