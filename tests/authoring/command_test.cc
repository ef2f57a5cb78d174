#include <gtest/gtest.h>
#include <stdlib.h>

#include <chrono>
#include <nlohmann/json.hpp>

#include "coach/reference.h"
#include "tests/authoring/bench.h"
#include "tests/session/process.h"

// `secondskin reference record` without a terminal, as a process.
namespace secondskin::authoring {
namespace {

using nlohmann::json;

class RecordCommand : public OwnFolder {
 protected:
  RecordCommand() { ::setenv("XDG_DATA_HOME", folder_.c_str(), 1); }

  struct Result {
    int exit_code;
    std::string output;
  };
  Result run(std::vector<std::string> words) const {
    words.insert(words.begin(), "reference");
    session::Process program(words, (folder_ / "output").string());
    EXPECT_TRUE(program.wait(std::chrono::seconds(60)));
    return {program.exit_code(), program.output()};
  }
  const std::string squats_ = kRoot / "reference_motions/deep_squat/learner.bvh";
};

TEST_F(RecordCommand, MakesAReferenceOfAFileThatTheProgramThenKnows) {
  const auto made = run({"record", "mine", squats_, "--json"});
  ASSERT_EQ(made.exit_code, 0) << made.output;
  const json said = json::parse(made.output);
  EXPECT_EQ(said["parts"].size(), 3U);
  const auto reference =
      coach::load_reference(said["folder"].get<std::string>(), kRoot / "joint_maps");
  EXPECT_EQ(reference.experts, 3U);
  EXPECT_NEAR(reference.motion.duration(), said["duration_s"].get<double>(), 1e-6);
  for (const auto& [name, joint] : said["joints"].items()) {
    const auto j = index(*find_joint(name));
    EXPECT_NEAR(reference.weight[j], joint["weight"].get<double>(), 1e-9);
    EXPECT_NEAR(reference.tolerance[j] * 180.0 / std::numbers::pi,
                joint["tolerance_deg"].get<double>(), 1e-9);
  }
  EXPECT_NE(run({"list"}).output.find("mine"), std::string::npos);
  const auto to = (folder_ / "mine.bvh").string();
  ASSERT_EQ(run({"export", "mine", "--to", to}).exit_code, 0);
  EXPECT_NEAR(read_canonical(to, kRoot / "joint_maps").duration(), reference.motion.duration(),
              1e-6);

  const auto again = run({"record", "mine", squats_, "--json"});
  EXPECT_NE(again.exit_code, 0);
  EXPECT_NE(again.output.find("exists already"), std::string::npos) << again.output;
}

TEST_F(RecordCommand, AddUsesTheSameWriterAndItsNames) {
  ASSERT_EQ(run({"add", squats_, "--name", "one", "--end", "3"}).exit_code, 0);
  EXPECT_TRUE(std::filesystem::exists(folder_ / "secondskin/reference_motions/one/motion.toml"));
  const auto bad = run({"add", squats_, "--name", "../one"});
  EXPECT_NE(bad.exit_code, 0);
  EXPECT_NE(bad.output.find("no '/'"), std::string::npos) << bad.output;
}

}  // namespace
}  // namespace secondskin::authoring
