#pragma once

#include <filesystem>
#include <string>

#include "motion/markers.h"
#include "motion/motion.h"
#include "server/pose_source.h"

/// A source's poses as a file for other programs.
namespace secondskin::authoring {

/// Runs the source to its end into a file that appears whole (a .mcap grows there), of the kind its
/// name says: .bvh (canonical body, metres, z up), .csv (time, root position, anatomical angles in
/// degrees), .c3d and .trc (the joints' centres), .mcap (skeleton and poses).
/// @param name  of the source, for the recording
/// @param idl   idl/secondskin_msgs.idl
/// @throws std::runtime_error naming the file and what was expected.
void export_source(server::PoseSource& source, const std::string& name,
                   const std::filesystem::path& idl, const std::filesystem::path& to);

/// The joints' centres as markers.
MarkerMotion joint_centres(const Motion& motion);

}  // namespace secondskin::authoring
