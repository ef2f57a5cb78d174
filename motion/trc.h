#pragma once

#include <filesystem>
#include <iosfwd>
#include <stdexcept>
#include <string_view>

#include "motion/markers.h"

/// TRC files (Motion Analysis, OpenSim): tab-separated text of labelled markers.
namespace secondskin {

/// What is wrong with a file and where: "FILE:LINE: found X, expected Y".
class TrcError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Reads markers in metres, the file's axes; the rate is DataRate. A marker is not visible where
/// its three fields are blank, missing at the line's end, not numbers ("NaN") or exactly 0.
/// @throws TrcError on anything but a whole file: counts that disagree with the header's, a unit
/// other than mm, cm, m or in, times that span 2 % more or less than DataRate says, a marker with
/// only some of its three fields.
MarkerMotion read_trc(const std::filesystem::path& file);
MarkerMotion read_trc(std::istream& in, std::string_view name);

/// Writes the markers with their axes as they are, in mm with five decimals; blank where not
/// visible. Residuals are not kept.
/// The file appears whole or not at all.
/// @throws TrcError for a name that a tab-separated line cannot hold, std::system_error where the
/// file cannot be written.
void write_trc(const MarkerMotion& markers, const std::filesystem::path& file);
void write_trc(const MarkerMotion& markers, std::ostream& out, std::string_view name);

}  // namespace secondskin
