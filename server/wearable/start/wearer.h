#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string_view>

#include "motion/anatomy.h"

/// A skeleton in the wearer's proportions, from the stature and what a tape measure tells.
namespace secondskin::server {

/// Bones that are as long on the left as on the right, and scale together.
enum class Bone : std::uint8_t {
  kTrunk,
  kHead,
  kShoulder,  ///< from the midline to the shoulder joint
  kUpperArm,
  kForearm,
  kHand,
  kHips,  ///< from the midline to the hip joint
  kThigh,
  kShank,
  kFoot,
};
inline constexpr std::size_t kBones = 10;
inline constexpr std::array<std::string_view, kBones> kBoneNames{
    "trunk", "head", "shoulder", "upper arm", "forearm", "hand", "hips", "thigh", "shank", "foot"};

/// What is measured of a wearer [m]. What is not follows from the stature.
struct Wearer {
  double stature = 1.75;
  std::optional<double> shoulder_width;  ///< between the shoulder joints
  std::optional<double> upper_arm;       ///< shoulder to elbow
  std::optional<double> forearm;         ///< elbow to wrist
  std::optional<double> hip_height;      ///< floor to hip joint (greater trochanter)
  std::optional<double> knee_height;     ///< floor to the knee's joint line
  std::optional<double> foot;            ///< heel to toe

  /// Reads these fields from a TOML file. @throws std::runtime_error naming file, line, field and
  /// what was expected.
  static Wearer load(const std::filesystem::path& file);
};

/// @throws std::invalid_argument naming the measure that does not fit a body of this stature
Skeleton wearer_skeleton(const Wearer& wearer);

/// How surely each bone is known from the measures, relative.
std::array<double, kBones> bone_sigmas(const Wearer& wearer);

/// The same body with its bones so many times as long.
Skeleton scaled(const Skeleton& canonical, const std::array<double, kBones>& scale);

}  // namespace secondskin::server
