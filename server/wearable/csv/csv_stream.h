#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "server/wearable/csv/csv_mapping.h"
#include "server/wearable/measurement.h"

/// A plain CSV table (or .csv.gz) of gyroscopes and accelerometers as a stream of measurements.
namespace secondskin::server {

/// What was amiss in a table, since its beginning. A reading is one board's gyroscope or
/// accelerometer at one instant.
struct CsvCounts {
  std::uint64_t rows = 0;
  std::uint64_t missing = 0;    ///< readings with an empty cell, NaN or an infinity
  std::uint64_t saturated = 0;  ///< readings at the end of the sensor's range
  std::uint64_t gaps = 0;       ///< rows that should have been there by the time column
  std::uint64_t late = 0;       ///< rows not later than the one before, left out
};

class CsvStream final : public MeasurementStream {
 public:
  /// @throws std::runtime_error naming the file and line or column, and what was expected
  CsvStream(const std::filesystem::path& table, CsvMapping mapping);
  ~CsvStream() override;

  const Garment& garment() const noexcept { return mapping_.garment; }
  const CsvMapping& mapping() const noexcept { return mapping_; }

  /// One row. Stamps count from the table's own zero. A missing reading is not valid; a cell with
  /// other text than a number @throws std::runtime_error naming file, line and column.
  Next next(Measurement& measurement) override;
  bool rewind() override;

  /// The recording system's own orientation of each board in the last row, q_ES; empty where the
  /// table has none.
  const std::vector<std::optional<Eigen::Quaterniond>>& orientations() const noexcept {
    return orientations_;
  }
  const CsvCounts& counts() const noexcept { return counts_; }

 private:
  struct Lines;
  struct Cell {
    std::size_t column;  // from 0
    double factor;
  };
  struct Cells {
    std::array<std::optional<std::array<Cell, 3>>, 3> vectors;  // gyro, accel, magnetic
    std::optional<std::array<Cell, 4>> orientation;
  };

  void read_header();
  void find_rate();
  [[nodiscard]] bool read_row();
  Cell find(const CsvColumn& column, double unit);
  [[nodiscard]] double value(const Cell& cell) const;  // NaN where there is none
  [[noreturn]] void fail(std::size_t column, std::string_view expected) const;

  std::filesystem::path file_;
  CsvMapping mapping_;
  std::unique_ptr<Lines> lines_;
  std::vector<std::string> header_;
  std::vector<std::string_view> cells_;  // of the last row
  std::vector<Cells> boards_;
  std::optional<Cell> time_;
  std::size_t columns_needed_ = 0;
  std::optional<std::int64_t> last_stamp_ns_;
  std::vector<std::optional<Eigen::Quaterniond>> orientations_;
  CsvCounts counts_;
};

}  // namespace secondskin::server
