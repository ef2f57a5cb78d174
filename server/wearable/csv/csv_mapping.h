#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "motion/garment.h"

/// Which column of a plain CSV table is which board's which axis: a TOML file beside the table
/// (docs/wearable.md lists its fields), so that a recording of any inertial system can be read.
///
/// Frames: B a segment; S a sensor board as the table's axes have it; E the earth frame of the
/// system that recorded, z up.
namespace secondskin::server {

/// A column by name or by number, and its sign.
struct CsvColumn {
  std::string name;        ///< as in the header, rows joined by "/"; empty: by number
  std::size_t number = 0;  ///< 1 is the first; 0: by name
  double sign = 1.0;
};

/// Where one board's readings are.
struct CsvBoard {
  std::optional<std::array<CsvColumn, 3>> gyro, accel, magnetic;
  std::optional<std::array<CsvColumn, 4>> orientation;  ///< w, x, y, z of q_ES, the system's own
  std::optional<Eigen::Quaterniond> q_BS;               ///< empty: not known, found at the start
};

struct CsvMapping {
  /// Boards only, no sources; its place on the segment may be rough.
  Garment garment;
  std::vector<CsvBoard> boards;  ///< one per board of the garment
  char separator = ',';
  std::size_t skip_rows = 0;      ///< before the header
  std::size_t header_rows = 1;    ///< 0: columns go by number
  std::optional<CsvColumn> time;  ///< empty: rows are evenly spaced
  double time_unit = 1.0;         ///< of the time column [s]; 0: it counts samples
  double rate_hz = 0.0;           ///< 0: told from the time column
  double gyro_unit = 1.0;         ///< [rad/s]
  double accel_unit = 1.0;        ///< [m/s^2]
  double magnetic_unit = 1.0;     ///< [T]

  /// @throws std::runtime_error naming file, line, field and what was expected
  static CsvMapping load(const std::filesystem::path& file);
};

/// The mapping that belongs to a table: FILE.toml beside FILE.csv or FILE.csv.gz.
std::filesystem::path mapping_beside(const std::filesystem::path& table);

}  // namespace secondskin::server
