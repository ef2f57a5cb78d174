#include "clients/players/jobs.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <fstream>

namespace secondskin::players {
namespace {

namespace fs = std::filesystem;

TEST(Jobs, PausedTheyEndWithoutAResultAndBeginNothing) {
  std::string name = (fs::temp_directory_path() / "secondskin_XXXXXX").string();
  const fs::path folder = ::mkdtemp(name.data());
  std::atomic<bool> runs{false}, second{false};
  {
    Jobs jobs(folder, 2);
    jobs.ensure("long", [&](const fs::path& part, const auto&, std::stop_token stop) {
      std::ofstream(part) << "half";
      runs = true;
      while (!stop.stop_requested()) std::this_thread::yield();
      if (stop.stop_requested()) throw std::runtime_error("ended");
      return std::string();
    });
    while (!runs) std::this_thread::yield();
    {
      const auto pause = jobs.pause();
      EXPECT_TRUE(fs::is_empty(folder)) << "nothing half made stays";
      EXPECT_FALSE(jobs.find("long")) << "who asks again begins again";
      jobs.ensure("short", [&](const fs::path& part, const auto&, std::stop_token) {
        std::ofstream(part) << "whole";
        second = true;
        return std::string("said");
      });
      EXPECT_FALSE(second);
      EXPECT_EQ(jobs.find("short")->state, JobStatus::State::kWaiting);
    }
    while (jobs.find("short")->state != JobStatus::State::kDone) std::this_thread::yield();
    EXPECT_EQ(jobs.find("short")->note, "said");
    EXPECT_TRUE(fs::exists(folder / "short.mcap"));
  }
  fs::remove_all(folder);
}

}  // namespace
}  // namespace secondskin::players
