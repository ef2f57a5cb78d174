#include "server/wearable/csv/csv_stream.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace secondskin::server {
namespace {

constexpr std::size_t kLongestLine = 1 << 20;
constexpr std::size_t kRowsForRate = 200;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kAround = " \r\t\"";
  const auto begin = text.find_first_not_of(kAround);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(kAround) - begin + 1);
}

void split(std::string_view line, char separator, std::vector<std::string_view>& cells) {
  cells.clear();
  for (std::size_t begin = 0; begin <= line.size();) {
    const auto end = std::min(line.find(separator, begin), line.size());
    cells.push_back(trimmed(line.substr(begin, end - begin)));
    begin = end + 1;
  }
}

bool says_missing(std::string_view text) {
  if (text.empty() || text == "-" || text == "null" || text == "NULL") return true;
  const auto is = [&](std::string_view word) {
    return std::equal(text.begin(), text.end(), word.begin(), word.end(), [](char a, char b) {
      return std::tolower(static_cast<unsigned char>(a)) == b;
    });
  };
  return is("nan") || is("na") || is("n/a") || is("none");
}

// The number in a cell; NaN for one that says that there is none; empty for other text.
std::optional<double> number(std::string_view text) {
  if (says_missing(text)) return kNaN;
  if (text.front() == '+') text.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error == std::errc::result_out_of_range) return kNaN;
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

// Lines of a plain or gzip file.
struct CsvStream::Lines {
  explicit Lines(const std::filesystem::path& file)
      : name(file.string()), in(gzopen(name.c_str(), "rb"), gzclose) {
    if (!in) throw std::runtime_error(name + ": cannot be read");
    gzbuffer(in.get(), 1 << 16);
  }

  bool next() {
    text.clear();
    char block[4096];
    while (gzgets(in.get(), block, sizeof block) != nullptr) {
      text += block;
      if (text.back() == '\n') break;
      if (text.size() > kLongestLine) {
        throw std::runtime_error(fmt::format("{}:{}: expected lines of a table", name, line + 1));
      }
    }
    int error = Z_OK;
    const char* what = gzerror(in.get(), &error);
    if (error != Z_OK && error != Z_STREAM_END) {
      throw std::runtime_error(fmt::format("{}: expected a whole file, found {} after line {}",
                                           name, error == Z_BUF_ERROR ? "a torn one" : what, line));
    }
    if (text.empty()) return false;
    ++line;
    if (text.back() == '\n') text.pop_back();
    if (line == 1 && text.starts_with("\xEF\xBB\xBF")) text.erase(0, 3);
    return true;
  }

  void rewind() {
    gzrewind(in.get());
    line = 0;
  }

  std::string name;
  std::unique_ptr<gzFile_s, int (*)(gzFile)> in;
  std::string text;
  std::size_t line = 0;
};

CsvStream::CsvStream(const std::filesystem::path& table, CsvMapping mapping)
    : file_(table), mapping_(std::move(mapping)), lines_(std::make_unique<Lines>(table)) {
  read_header();
  if (mapping_.time) {
    const double unit = mapping_.time_unit > 0.0 ? mapping_.time_unit : 1.0 / mapping_.rate_hz;
    time_ = find(*mapping_.time, unit);
  }
  for (const CsvBoard& board : mapping_.boards) {
    Cells cells;
    const std::array from{&board.gyro, &board.accel, &board.magnetic};
    const std::array units{mapping_.gyro_unit, mapping_.accel_unit, mapping_.magnetic_unit};
    for (std::size_t kind = 0; kind < from.size(); ++kind) {
      if (!*from[kind]) continue;
      cells.vectors[kind].emplace();
      for (std::size_t axis = 0; axis < 3; ++axis) {
        (*cells.vectors[kind])[axis] = find((**from[kind])[axis], units[kind]);
      }
    }
    if (board.orientation) {
      cells.orientation.emplace();
      for (std::size_t i = 0; i < 4; ++i) {
        (*cells.orientation)[i] = find((*board.orientation)[i], 1.0);
      }
    }
    boards_.push_back(cells);
  }
  orientations_.resize(boards_.size());
  if (mapping_.rate_hz == 0.0) find_rate();
  mapping_.garment.inertial_rate_hz = mapping_.rate_hz;
  rewind();
  if (!read_row()) {
    throw std::runtime_error(
        fmt::format("{}: expected rows of numbers, found none", file_.string()));
  }
  // A wrong separator or mapping shows here; later short rows are the recording's damage.
  if (cells_.size() < columns_needed_) {
    throw std::runtime_error(fmt::format("{}:{}: expected {} columns at least, found {}",
                                         file_.string(), lines_->line, columns_needed_,
                                         cells_.size()));
  }
  rewind();
}

CsvStream::~CsvStream() = default;

void CsvStream::read_header() {
  for (std::size_t i = 0; i < mapping_.skip_rows; ++i) (void)lines_->next();
  header_.clear();
  for (std::size_t row = 0; row < mapping_.header_rows; ++row) {
    if (!lines_->next()) {
      throw std::runtime_error(fmt::format("{}: expected {} header rows, found {}", file_.string(),
                                           mapping_.header_rows, row));
    }
    split(lines_->text, mapping_.separator, cells_);
    header_.resize(std::max(header_.size(), cells_.size()));
    for (std::size_t i = 0; i < cells_.size(); ++i) {
      if (row > 0) header_[i] += '/';
      header_[i] += cells_[i];
    }
  }
}

CsvStream::Cell CsvStream::find(const CsvColumn& column, double unit) {
  std::size_t at = column.number - 1;
  if (column.number == 0) {
    const auto found = std::find(header_.begin(), header_.end(), column.name);
    if (found == header_.end()) {
      std::string known = fmt::format("{}", fmt::join(header_, ", "));
      if (known.size() > 400) known = known.substr(0, 400) + "...";
      throw std::runtime_error(fmt::format("{}:{}: no column '{}'; there are: {}", file_.string(),
                                           mapping_.skip_rows + mapping_.header_rows, column.name,
                                           known));
    }
    at = static_cast<std::size_t>(found - header_.begin());
  }
  columns_needed_ = std::max(columns_needed_, at + 1);
  return {at, unit * column.sign};
}

bool CsvStream::read_row() {
  do {
    if (!lines_->next()) return false;
  } while (trimmed(lines_->text).empty());
  split(lines_->text, mapping_.separator, cells_);
  return true;
}

void CsvStream::fail(std::size_t column, std::string_view expected) const {
  const std::string_view found = column < cells_.size() ? cells_[column] : std::string_view{};
  throw std::runtime_error(
      fmt::format("{}:{}: column {}{}: expected {}, found '{}'", file_.string(), lines_->line,
                  column + 1, column < header_.size() ? fmt::format(" ({})", header_[column]) : "",
                  expected, found.substr(0, 40)));
}

double CsvStream::value(const Cell& cell) const {
  if (cell.column >= cells_.size()) return kNaN;
  const auto read = number(cells_[cell.column]);
  if (!read) fail(cell.column, "a number");
  return std::isfinite(*read) ? *read * cell.factor : kNaN;
}

void CsvStream::find_rate() {
  std::vector<double> steps;
  double before = kNaN;
  while (steps.size() < kRowsForRate && read_row()) {
    const double now = value(*time_);
    if (now > before) steps.push_back(now - before);
    before = now;
  }
  if (steps.empty()) {
    fail(time_->column, "times that grow from row to row, or rate_hz in the mapping");
  }
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  mapping_.rate_hz = 1.0 / *middle;
}

bool CsvStream::rewind() {
  lines_->rewind();
  read_header();
  last_stamp_ns_.reset();
  counts_ = {};
  return true;
}

Next CsvStream::next(Measurement& measurement) {
  std::int64_t stamp_ns = 0;
  do {
    if (!read_row()) return Next::kEnd;
    if (time_) {
      const double time = value(*time_);
      if (!std::isfinite(time) || std::abs(time) > 9e9) fail(time_->column, "a time");
      stamp_ns = static_cast<std::int64_t>(std::llround(time * 1e9));
    } else {
      stamp_ns = static_cast<std::int64_t>(
          std::llround(1e9 * static_cast<double>(counts_.rows) / mapping_.rate_hz));
    }
    ++counts_.rows;
    if (!last_stamp_ns_ || stamp_ns > *last_stamp_ns_) break;
    ++counts_.late;
  } while (true);
  if (last_stamp_ns_) {
    const double steps = 1e-9 * static_cast<double>(stamp_ns - *last_stamp_ns_) * mapping_.rate_hz;
    counts_.gaps += static_cast<std::uint64_t>(std::max(0.0, std::round(steps) - 1.0));
  }
  last_stamp_ns_ = stamp_ns;

  measurement.kind = MeasurementKind::kInertial;
  measurement.stamp_ns = stamp_ns;
  measurement.boards.resize(boards_.size());
  measurement.distances.clear();
  for (std::size_t b = 0; b < boards_.size(); ++b) {
    BoardReading& reading = measurement.boards[b];
    reading = {};
    const SensorBoard& board = mapping_.garment.boards[b];
    const std::array to{&reading.gyro, &reading.accel, &reading.magnetic};
    const std::array valid{&reading.gyro_valid, &reading.accel_valid, &reading.magnetic_valid};
    const std::array range{board.gyro_range, board.accel_range,
                           std::numeric_limits<double>::infinity()};
    for (std::size_t kind = 0; kind < to.size(); ++kind) {
      const auto& from = boards_[b].vectors[kind];
      if (!from) continue;
      Eigen::Vector3d v;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        v[static_cast<Eigen::Index>(axis)] = value((*from)[axis]);
      }
      if (!v.allFinite()) {
        ++counts_.missing;
      } else if (v.cwiseAbs().maxCoeff() >= 0.999 * range[kind]) {
        ++counts_.saturated;
      } else {
        *to[kind] = v;
        *valid[kind] = true;
      }
    }
    orientations_[b].reset();
    if (const auto& from = boards_[b].orientation) {
      const Eigen::Quaterniond q(value((*from)[0]), value((*from)[1]), value((*from)[2]),
                                 value((*from)[3]));
      if (std::abs(q.norm() - 1.0) < 0.1) orientations_[b] = q.normalized();
    }
  }
  return Next::kPose;
}

}  // namespace secondskin::server
