#include <gtest/gtest.h>
#include <sys/resource.h>

#include <fstream>

#include "recording/mcap_reader.h"
#include "session.h"

// What a user can do wrong, and what they are told. Each message names the thing and what to do.

namespace secondskin::session {
namespace {

const std::string kLearner = SECONDSKIN_SOURCE_DIR "/reference_motions/low_block/learner.bvh";

class BadInput : public testing::Test {
 protected:
  // Runs to the end; it must fail and say all of these words, in one line that names the program.
  void fails(const std::vector<std::string>& command, const std::vector<std::string>& words) {
    Process process = session_.start("bad", command);
    ASSERT_TRUE(process.wait(30s)) << process.output();
    EXPECT_NE(process.exit_code(), 0) << process.output();
    EXPECT_LT(process.exit_code(), 128) << "it crashed\n" << process.output();
    for (const auto& word : words) {
      EXPECT_TRUE(process.says(word)) << "'" << word << "' is missing in\n" << process.output();
    }
  }
  std::string file(const std::string& name, const std::string& text) const {
    std::ofstream(session_.folder / name) << text;
    return session_.folder / name;
  }
  Session session_;
};

TEST_F(BadInput, AMissingMotionFileIsNamed) {
  fails({"export", "nowhere.bvh", "--to", "x.csv"}, {"nowhere.bvh", "no such file"});
  fails({"train", "--learner", "nowhere.bvh"}, {"nowhere.bvh", "no such file"});
  fails({"capture", "nowhere.bvh"}, {"nowhere.bvh", "no such file"});
}

TEST_F(BadInput, ATornMotionFileIsNamedWithLineAndColumn) {
  const std::string whole = read_text(kLearner);
  const std::string torn = file("torn.bvh", whole.substr(0, whole.size() / 2));
  fails({"capture", torn}, {"torn.bvh:", "expected"});
  const auto frame = whole.find("Frame Time");
  std::string broken = whole;
  broken.replace(whole.find('\n', frame) + 1, 4, "nan ");
  fails({"capture", file("nan.bvh", broken)}, {"nan.bvh:", "nan", "expected"});
}

TEST_F(BadInput, AnUnknownReferenceListsTheKnownOnes) {
  fails({"train", "--reference", "salto"}, {"salto", "low_block"});
  fails({"coach", "--reference", "salto"}, {"salto", "low_block"});
}

TEST_F(BadInput, AnUnknownJointInAReferenceIsNamedWithItsLine) {
  const std::string folder = session_.folder / "mine";
  std::filesystem::create_directory(folder);
  std::filesystem::copy(SECONDSKIN_SOURCE_DIR "/reference_motions/low_block/motion.bvh",
                        folder + "/motion.bvh");
  std::ofstream(folder + "/motion.toml") << "name = \"mine\"\n[weights]\nleft_tentacle = 1.0\n";
  fails({"reference", "show", folder}, {"motion.toml", "3", "left_tentacle"});
}

TEST_F(BadInput, AFileWithoutABodyIsRefused) {
  const std::string text =
      "HIERARCHY\nROOT thing\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition "
      "Zrotation Xrotation Yrotation\n End Site\n {\n  OFFSET 0 1 0\n }\n}\nMOTION\nFrames: 1\n"
      "Frame Time: 0.01\n0 0 0 0 0 0\n";
  fails({"capture", file("thing.bvh", text)}, {"thing"});
}

TEST_F(BadInput, AWrongBodyMapIsNamed) {
  fails({"train", "--body-map", "octopus"}, {"octopus", "full_body"});
}

TEST_F(BadInput, AFileThatIsNoRecordingIsRefused) {
  fails({"info", file("no.mcap", "hello")}, {"no.mcap"});
  fails({"replay", file("no2.mcap", ""), "--coach"}, {"no2.mcap"});
}

TEST_F(BadInput, ARecordingIsNeverOverwritten) {
  const std::string taken = file("taken.mcap", "precious");
  fails(session_.on_bus({"record", taken}), {"taken.mcap"});
  EXPECT_EQ(read_text(taken), "precious");
}

TEST_F(BadInput, AnUnknownOptionOrCommandSaysWhereHelpIs) {
  fails({"dance"}, {"--help"});
  fails({"train", "--port"}, {"--port"});
  fails({"capture", kLearner, "--speed", "-1"}, {"--speed"});
  fails({"capture", kLearner, "--domain", "500"}, {"500"});
}

TEST_F(BadInput, ASecondCaptureServerForTheSameSubjectIsRefused) {
  Process first = session_.capture();
  ASSERT_TRUE(eventually([&] { return first.says("capture:"); }, 20s)) << first.output();
  fails(session_.on_bus({"capture", kLearner}), {"another capture server", "--subject"});
}

TEST_F(BadInput, ASecondCoachForTheSameSubjectIsRefused) {
  Process first = session_.coach();
  std::this_thread::sleep_for(1s);  // it is up
  fails(session_.on_bus({"coach", "--reference", "squat"}), {"another coach", "--subject"});
}

TEST_F(BadInput, ABoardThatIsNotThereIsNamedAndSoIsOneInUse) {
  fails(session_.on_bus({"train", "--reference", "jumping_jack", "--port", "/dev/nothing",
                         "--recording", session_.folder / "no_board.mcap"}),
        {"/dev/nothing", "not there", "NEVER REACHED"});
  Process board = session_.board();
  ASSERT_TRUE(eventually([&] { return board.says("port "); }, 10s));
  Process first = session_.tactors();
  ASSERT_TRUE(eventually([&] { return first.says("tactor board on"); }, 10s));
  Process second =
      session_.start("second", session_.on_bus({"tactors", "--port", session_.port()}));
  EXPECT_TRUE(eventually([&] { return second.says("in use by another program"); }, 10s))
      << second.output();
}

TEST_F(BadInput, AMistakeInTheOptionFileIsNotPassedOver) {
  fails({"--config", file("typo.toml", "[train]\nrefrence = \"squat\"\n"), "train"}, {"refrence"});
  fails({"train", "--config", file("torn.toml", "[train\nreference = \"squat\"\n")}, {"[train"});
  fails({"frobnicate"}, {"frobnicate", "--help"});
}

TEST_F(BadInput, AStopThatNobodyHearsIsNoSuccess) {
  Process recorder =
      session_.start("record", session_.on_bus({"record", session_.folder / "only.mcap"}));
  ASSERT_TRUE(eventually([&] { return recorder.says("recording to"); }, 10s));
  fails(session_.on_bus({"stop"}), {"nobody obeys"});
}

TEST_F(BadInput, AFullDiskEndsTheRecordingButLosesNothingStored) {
  const std::string path = session_.folder / "full.mcap";
  Process recorder = session_.start("record", session_.on_bus({"record", path}), [] {
    const rlimit limit{400'000, 400'000};  // bytes a file: the disk ends here
    ::setrlimit(RLIMIT_FSIZE, &limit);
  });
  Process capture = session_.start(
      "capture", session_.on_bus({"capture", kLearner, "--fast", "--loop", "--wait-for", "1"}));
  ASSERT_TRUE(recorder.wait(60s)) << recorder.output();
  EXPECT_NE(recorder.exit_code(), 0);
  EXPECT_LT(recorder.exit_code(), 128) << recorder.output();
  EXPECT_TRUE(recorder.says("full.mcap")) << recorder.output();
  recording::McapReader reader(path);
  EXPECT_GT(reader.find("/pose")->messages, 100u);
}

}  // namespace
}  // namespace secondskin::session
