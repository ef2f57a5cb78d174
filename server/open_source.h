#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "motion/retarget.h"
#include "server/pose_source.h"

namespace secondskin::server {

/// Opens what a user names as a SOURCE: "replay:FILE" or just FILE (.bvh, .mcap).
/// @throws std::runtime_error naming the source, and the kinds that there are when it is none.
std::unique_ptr<PoseSource> open_source(const std::string& source,
                                        const std::filesystem::path& joint_maps,
                                        const RetargetOptions& retarget = {});

/// All poses of a source as a motion, as fast as it yields them. Recordings with uneven stamps are
/// resampled at their nominal rate. Invalid poses are left out.
Motion read_all(PoseSource& source);

}  // namespace secondskin::server
