#pragma once

#include <filesystem>
#include <iosfwd>
#include <stdexcept>
#include <string_view>

#include "motion/motion.h"

/// Biovision hierarchy files, as they are: the file's own joints, axes and unit.
///
/// Channels may come in any order and be three or six a joint. A joint other than the root keeps
/// its OFFSET even where it has position channels, which exporters fill with world coordinates,
/// with the offset itself or with noise; BvhFile says how many such joints there are. A root's
/// position channels are absolute and replace its OFFSET. Conversion to the canonical body is
/// retarget.h's.
namespace secondskin {

struct BvhFile {
  Motion motion;  ///< native names; lengths in the file's unit, axes as in the file
  std::size_t ignored_position_joints = 0;  ///< joints whose position channels were not used
};

/// What is wrong with a file and where: "FILE:LINE:COLUMN: found X, expected Y".
class BvhError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// @throws BvhError on anything but a whole BVH file with finite numbers.
BvhFile read_bvh(const std::filesystem::path& file);
BvhFile read_bvh(std::istream& in, std::string_view name);

/// Writes the motion with its skeleton's names, offsets and axes as they are; root with six
/// channels, other joints with three, order ZXY in degrees; six decimals, so that a joint position
/// survives within 0.1 mm. The root's OFFSET is 0, so that programs that add it to its position
/// agree with those that do not.
/// The file appears whole or not at all (written beside its place and renamed).
/// @throws std::system_error naming the file when it cannot be written.
void write_bvh(const Motion& motion, const std::filesystem::path& file);
void write_bvh(const Motion& motion, std::ostream& out);

}  // namespace secondskin
