#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <filesystem>
#include <stdexcept>
#include <string_view>
#include <vector>

#include "motion/markers.h"

/// Files of the UI-PRMD data set of physiotherapy exercises (Vakanski et al., Data 2018, 3(1), 2):
/// one repetition a file, a row of 117 numbers a frame at 100 Hz, no header; optionally gzipped.
namespace secondskin {

inline constexpr std::size_t kUiPrmdTriplets = 39;
inline constexpr double kUiPrmdRateHz = 100.0;

/// The Plug-in Gait markers in the order of their columns.
inline constexpr std::array<std::string_view, kUiPrmdTriplets> kUiPrmdMarkers{
    "LFHD", "RFHD", "LBHD", "RBHD", "C7",   "T10",  "CLAV", "STRN", "RBAK", "LSHO",
    "LUPA", "LELB", "LFRM", "LWRA", "LWRB", "LFIN", "RSHO", "RUPA", "RELB", "RFRM",
    "RWRA", "RWRB", "RFIN", "LASI", "RASI", "LPSI", "RPSI", "LTHI", "LKNE", "LTIB",
    "LANK", "LHEE", "LTOE", "RTHI", "RKNE", "RTIB", "RANK", "RHEE", "RTOE"};

/// Which triplet of an angle file is which joint's, told by their ranges of motion. Of the elbow
/// only the first value is used; the first value of hip, knee and ankle is flexion.
inline constexpr std::size_t kUiPrmdLeftHip = 15;
inline constexpr std::size_t kUiPrmdRightHip = 16;
inline constexpr std::size_t kUiPrmdLeftKnee = 19;
inline constexpr std::size_t kUiPrmdRightKnee = 20;
inline constexpr std::size_t kUiPrmdLeftAnkle = 23;
inline constexpr std::size_t kUiPrmdRightAnkle = 24;
inline constexpr std::size_t kUiPrmdLeftShoulder = 27;
inline constexpr std::size_t kUiPrmdRightShoulder = 28;
inline constexpr std::size_t kUiPrmdLeftElbow = 29;
inline constexpr std::size_t kUiPrmdRightElbow = 30;
inline constexpr std::size_t kUiPrmdLeftWrist = 33;
inline constexpr std::size_t kUiPrmdRightWrist = 34;

/// Vicon's angles of one frame, as in the file.
using UiPrmdAngles = std::array<Eigen::Vector3d, kUiPrmdTriplets>;  // [degrees]

/// What is wrong with a file and where: "FILE:LINE: found X, expected Y".
class UiPrmdError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Reads markers in metres, z up, at 100 Hz; one at exactly (0, 0, 0) was not seen.
/// Numbers stand apart by commas, blanks or tabs.
/// @throws UiPrmdError on anything but whole rows of 117 finite numbers, or a torn gzip file.
MarkerMotion read_ui_prmd_markers(const std::filesystem::path& file);

/// Reads a file of joint angles, one element a frame at 100 Hz.
/// @throws UiPrmdError as read_ui_prmd_markers does.
std::vector<UiPrmdAngles> read_ui_prmd_angles(const std::filesystem::path& file);

}  // namespace secondskin
