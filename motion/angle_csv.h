#pragma once

#include <iosfwd>

#include "motion/anatomy.h"

/// A canonical motion as a table that people read: time, root position, anatomical angles.
namespace secondskin {

/// Writes the header row: t, root_x, root_y, root_z (m), then <joint>_<movement>_deg for every
/// movement that the joint has.
void write_angle_csv_header(std::ostream& out);

/// Writes one row. A joint with confidence 0 leaves its fields empty.
/// @param time  seconds from the start
void write_angle_csv_row(std::ostream& out, double time, const Pose& canonical);

}  // namespace secondskin
