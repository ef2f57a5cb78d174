#include "motion/ui_prmd.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <memory>
#include <string>

namespace secondskin {
namespace {

constexpr std::size_t kColumns = 3 * kUiPrmdTriplets;
// Far more than an hour of rows. A gzip file can hold a thousand times what it weighs.
constexpr std::size_t kLargestText = std::size_t{1} << 30;
constexpr double kLargestValue = 1e9;
constexpr double kMillimetre = 0.001;

[[noreturn]] void fail(std::string_view file, std::size_t line, std::string_view found,
                       std::string_view expected) {
  throw UiPrmdError(fmt::format("{}:{}: found {}, expected {}", file, line, found, expected));
}

// The file's text, unpacked if it is packed.
std::string read_text(const std::filesystem::path& file) {
  const std::string name = file.string();
  std::error_code ignored;
  const std::unique_ptr<gzFile_s, int (*)(gzFile)> in(gzopen(name.c_str(), "rb"), gzclose);
  if (!in || std::filesystem::is_directory(file, ignored)) {
    fail(name, 1, "no readable file", "a UI-PRMD file");
  }
  std::string text;
  std::array<char, 1 << 16> block;
  for (;;) {
    const int count = gzread(in.get(), block.data(), static_cast<unsigned>(block.size()));
    int error = Z_OK;
    const char* what = gzerror(in.get(), &error);
    if (count < 0 || (error != Z_OK && error != Z_STREAM_END)) {
      fail(name, 1 + static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n')),
           fmt::format("a gzip error ({})", error == Z_BUF_ERROR ? "torn" : what),
           "a whole gzip file");
    }
    if (count == 0) return text;
    if (text.size() > kLargestText) fail(name, 1, "more than 1 GiB of text", "one repetition");
    text.append(block.data(), static_cast<std::size_t>(count));
  }
}

// Calls use(row) with the 117 numbers of each row.
template <typename Use>
void read_rows(const std::filesystem::path& file, Use use) {
  const std::string text = read_text(file);
  const std::string name = file.string();
  std::array<double, kColumns> row{};
  std::size_t line = 0, rows = 0;
  for (std::size_t at = 0; at < text.size();) {
    ++line;
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const char* p = text.data() + at;
    const char* const stop = text.data() + end;
    at = end + 1;
    const auto skip_blanks = [&] {
      while (p != stop && (*p == ' ' || *p == '\t' || *p == '\r')) ++p;
    };
    skip_blanks();
    if (p == stop) continue;
    for (std::size_t i = 0; i < kColumns; ++i) {
      if (p == stop) {
        fail(name, line, fmt::format("{} numbers", i), fmt::format("{}", kColumns));
      }
      if (*p == '+') ++p;
      const auto [next, error] = std::from_chars(p, stop, row[i]);
      // The comparison also refuses NaN.
      if (error != std::errc() || !(std::abs(row[i]) <= kLargestValue)) {
        const char* word = std::find_if(p, stop, [](char c) { return c == ',' || c == ' '; });
        fail(name, line,
             fmt::format("\"{}\" as number {}",
                         std::string_view(p, std::min<std::size_t>(word - p, 40)), i + 1),
             "a finite number");
      }
      p = next;
      const char* const before = p;
      skip_blanks();
      bool apart = p != before || p == stop;
      if (p != stop && *p == ',') {
        ++p;
        skip_blanks();
        apart = true;
      }
      if (!apart) {
        fail(name, line, fmt::format("\"{}\" after number {}", *p, i + 1), "a comma or a blank");
      }
    }
    if (p != stop) {
      fail(name, line, fmt::format("more than {} numbers", kColumns), "that many");
    }
    use(row);
    ++rows;
  }
  if (rows == 0) fail(name, 1, "no rows", fmt::format("rows of {} numbers", kColumns));
}

}  // namespace

MarkerMotion read_ui_prmd_markers(const std::filesystem::path& file) {
  MarkerMotion motion;
  motion.names.assign(kUiPrmdMarkers.begin(), kUiPrmdMarkers.end());
  motion.rate_hz = kUiPrmdRateHz;
  read_rows(file, [&](const std::array<double, kColumns>& row) {
    MarkerFrame& frame = motion.frames.emplace_back(kUiPrmdTriplets);
    for (std::size_t i = 0; i < kUiPrmdTriplets; ++i) {
      const Eigen::Vector3d p_mm(row[3 * i], row[3 * i + 1], row[3 * i + 2]);
      if (p_mm.isZero(0.0)) continue;
      frame.p_WM[i] = kMillimetre * p_mm;
      frame.visible[i] = 1;
    }
  });
  return motion;
}

std::vector<UiPrmdAngles> read_ui_prmd_angles(const std::filesystem::path& file) {
  std::vector<UiPrmdAngles> frames;
  read_rows(file, [&](const std::array<double, kColumns>& row) {
    UiPrmdAngles& frame = frames.emplace_back();
    for (std::size_t i = 0; i < kUiPrmdTriplets; ++i) {
      frame[i] = {row[3 * i], row[3 * i + 1], row[3 * i + 2]};
    }
  });
  return frames;
}

}  // namespace secondskin
