#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "clients/authoring/draft.h"

/// The one writer of reference folders (docs/reference-motions.md).
namespace secondskin::authoring {

/// All that a reference folder says.
struct Recipe {
  std::string name;
  std::string description, origin;
  std::string licence = "private";
  bool standing = false;
  std::vector<Motion> performances;  ///< canonical; the reference is their mean
  ByJoint weight;                    ///< 0 to 1, one at least above 0
  ByJoint tolerance;                 ///< 0.1 to 180 degrees [rad]
};

/// A recipe with all joints alike and the default tolerance.
Recipe plain_recipe(std::string name, std::vector<Motion> performances);

/// @throws std::invalid_argument unless it is 1 to 64 letters, digits, '_' and '-', and begins with
/// a letter or digit: what a session command may name.
void require_reference_name(const std::string& name);

/// Writes references/NAME: motion.bvh, expert_2.bvh, ..., motion.toml. It appears whole or not at
/// all, and only if the coach can load it.
/// @param references  a folder, made if there is none
/// @returns the reference's folder
/// @throws std::invalid_argument naming the field that is wrong (a name has 1 to 64 characters, no
///         '/' and no '.' first), or that the name is taken;
///         std::system_error naming the file when the disk refuses.
std::filesystem::path save_reference(const Recipe& recipe, const std::filesystem::path& references,
                                     const std::filesystem::path& joint_maps);

}  // namespace secondskin::authoring
