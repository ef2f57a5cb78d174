#pragma once

#include <array>
#include <optional>
#include <span>
#include <string_view>

#include "motion/t_pose.h"

/// Xsens MVN's body: 23 segments, each with its place and orientation in the world (z up), all
/// orientations identity in the T-pose. Its trunk has one segment more than the canonical one: L3,
/// which on the way out moves with L5 and on the way in is left out.
namespace secondskin {

inline constexpr std::size_t kXsensSegmentCount = 23;
inline constexpr std::size_t kXsensL3 = 2;

/// In the protocol's order; a segment's id is its place here plus 1 (protocol, section 3.1).
inline constexpr std::array<std::string_view, kXsensSegmentCount> kXsensSegmentNames{
    "Pelvis",
    "L5",
    "L3",
    "T12",
    "T8",
    "Neck",
    "Head",
    "RightShoulder",
    "RightUpperArm",
    "RightForeArm",
    "RightHand",
    "LeftShoulder",
    "LeftUpperArm",
    "LeftForeArm",
    "LeftHand",
    "RightUpperLeg",
    "RightLowerLeg",
    "RightFoot",
    "RightToe",
    "LeftUpperLeg",
    "LeftLowerLeg",
    "LeftFoot",
    "LeftToe"};

/// Where each canonical joint's segment stands among them.
inline constexpr std::array<std::size_t, kJointCount> kXsensSegmentOf{
    0,  1,  3,  4,    // pelvis, spine_lower, spine_middle, spine_upper
    5,  6,            // neck, head
    11, 12, 13, 14,   // left clavicle, shoulder, elbow, wrist
    7,  8,  9,  10,   // right
    19, 20, 21, 22,   // left hip, knee, ankle, toes
    15, 16, 17, 18};  // right

/// @param joints  one per canonical joint; @param xsens  out, kXsensSegmentCount
void to_xsens(std::span<const TPoseSegment> joints, std::span<TPoseSegment> xsens) noexcept;
void from_xsens(std::span<const TPoseSegment> xsens, std::span<TPoseSegment> joints) noexcept;

/// The body that a single pose shows: joint offsets are constant in their segments.
/// @throws std::runtime_error as skeleton_from_t_pose()
Skeleton xsens_skeleton(std::span<const TPoseSegment> xsens);

}  // namespace secondskin
