#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include "motion/anatomy.h"
#include "motion/retarget.h"
#include "motion/rotation.h"

/// What the tests of authoring share: shipped recordings, made motions, a folder of their own.
namespace secondskin::authoring {

inline const std::filesystem::path kRoot = SECONDSKIN_SOURCE_DIR;
inline const std::filesystem::path kJointMaps = kRoot / "joint_maps";

inline Motion shipped(const std::string& reference, const std::string& file) {
  return read_canonical(kRoot / "reference_motions" / reference / file, kJointMaps);
}

/// Both arms go up and down: 0 at rest, 1 up. @param phase  in [0, 1] of the way, by frame
inline Motion arms(const std::vector<double>& way, double rate_hz, double elbow = 0.3) {
  Motion motion{canonical_skeleton(), rate_hz, {}};
  for (const double w : way) {
    Pose pose(kJointCount);
    pose.p_WR = {0.0, 0.0, 0.95};
    for (const Joint side : {Joint::kLeftShoulder, Joint::kRightShoulder}) {
      pose.q_PB[index(side)] = joint_rotation(side, {0.2 * w, 1.5 * w, 0.0});
    }
    for (const Joint side : {Joint::kLeftElbow, Joint::kRightElbow}) {
      pose.q_PB[index(side)] = joint_rotation(side, {0.1 + elbow * w, 0.0, 0.0});
    }
    motion.poses.push_back(pose);
  }
  return motion;
}

/// Up and down once in `seconds`.
inline void raise(std::vector<double>& way, double seconds, double rate_hz) {
  const auto n = static_cast<int>(std::lround(seconds * rate_hz));
  for (int i = 0; i < n; ++i) way.push_back(0.5 - 0.5 * std::cos(2.0 * std::numbers::pi * i / n));
}

inline void rest(std::vector<double>& way, double seconds, double rate_hz) {
  way.insert(way.end(), static_cast<std::size_t>(std::lround(seconds * rate_hz)), 0.0);
}

/// A folder that goes with the test.
class OwnFolder : public ::testing::Test {
 protected:
  OwnFolder()
      : folder_(std::filesystem::temp_directory_path() /
                ("secondskin_authoring_" + std::to_string(::getpid()))) {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~OwnFolder() override { std::filesystem::remove_all(folder_); }

  std::size_t files_in(const std::filesystem::path& folder) const {
    std::size_t n = 0;
    if (!std::filesystem::exists(folder)) return 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++n;
    return n;
  }

  std::filesystem::path folder_;
};

}  // namespace secondskin::authoring
