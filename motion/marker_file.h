#pragma once

#include <filesystem>
#include <optional>
#include <stdexcept>

#include "motion/markers.h"
#include "motion/retarget.h"

/// Marker files of any kind, turned to metres and z up, and back.
namespace secondskin {

/// A file whose kind or up axis cannot be told, naming it and what was expected.
class MarkerFileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// True for a name that ends as read_markers expects: .c3d, .trc, .txt, .txt.gz; capitals do not
/// matter.
bool is_marker_file(const std::filesystem::path& file);

/// Reads a C3D, TRC or UI-PRMD marker file (.txt, .txt.gz) as metres, z up.
/// Up is z in UI-PRMD, y in TRC, and in C3D what POINT:Y_SCREEN says, z where it is missing; y up
/// is turned as read_canonical does it: x = z', y = x', z = y'.
/// @param up  the file's up axis, where it is known better
/// @throws MarkerFileError, C3dError, TrcError or UiPrmdError.
MarkerMotion read_markers(const std::filesystem::path& file, std::optional<UpAxis> up = {});

/// Writes markers that are in metres, z up, as a TRC (y up, mm) or C3D file (z up, mm, Intel,
/// real), by the name's ending.
/// The file appears whole or not at all.
/// @throws MarkerFileError for another ending; std::system_error, C3dError or TrcError as the
/// format's own writer.
void write_markers(const MarkerMotion& markers, const std::filesystem::path& file);

}  // namespace secondskin
