#pragma once

#include <time.h>

#include <cstdint>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace secondskin::session {

/// What the virtual board's tactors did, as it recorded them.
struct WaveformRow {
  std::int64_t monotonic_ns;
  std::size_t slots_on;
  double strongest;  ///< of the sixteen drives
};

inline std::vector<WaveformRow> read_waveform(const std::string& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  std::vector<WaveformRow> rows;
  while (std::getline(in, line) && !in.eof()) {  // a last line without its end is still written
    std::istringstream fields(line);
    std::string field;
    WaveformRow row{};
    std::getline(fields, field, ',');
    row.monotonic_ns = std::stoll(field);
    std::getline(fields, field, ',');
    row.slots_on = std::stoul(field);
    while (std::getline(fields, field, ','))
      row.strongest = std::max(row.strongest, std::stod(field));
    rows.push_back(row);
  }
  return rows;
}

inline std::int64_t monotonic_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000ll + now.tv_nsec;
}

/// Whether something is commanded on right now.
inline bool is_on(const std::string& file) {
  const auto rows = read_waveform(file);
  return !rows.empty() && rows.back().slots_on > 0;
}

}  // namespace secondskin::session
