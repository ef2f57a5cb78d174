#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "coach/tactile/body_map.h"
#include "motion/skeleton.h"

/// What Foxglove draws without a plug-in: foxglove.FrameTransforms and foxglove.SceneUpdate as
/// JSON. Pure.
namespace secondskin::dashboard {

/// A body as it stands.
struct Figure {
  const Skeleton& skeleton;  ///< canonical
  const Pose& pose;          ///< valid
};

/// Of each channel the strongest drive of any of its slots, 0 to 1.
std::array<double, wire::kTactorCount> levels(const wire::BoardState& state) noexcept;

/// Frames `<subject>/<joint>`, each in its parent's, the root's in `world`; the expert's
/// `<subject>/expert/<joint>`.
/// @param expert  null: none
std::string frame_transforms(std::int64_t time_ns, const std::string& subject,
                             const Figure& learner, const Figure* expert);

/// Entities `learner`, `expert` and `tactors`, all in `world`.
std::string scene_update(std::int64_t time_ns, const Figure& learner, const Figure* expert,
                         std::span<const coach::Tactor> tactors,
                         const std::array<double, wire::kTactorCount>& levels);

}  // namespace secondskin::dashboard
