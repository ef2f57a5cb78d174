#include "server/wearable/calibrate/source_offsets.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <set>
#include <stdexcept>

namespace secondskin::server {
namespace {

constexpr double kNearest = 0.1, kFarthest = 2.0;  // that a known distance may be [m]
constexpr std::size_t kLeastPulses = 5;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct Row {
  std::size_t placement, source;
  double distance;    // [m]
  double inflection;  // [A/D samples]
  double peak;
};

// Mean offset of a source over the rows, without those of one placement.
struct Offset {
  double sum = 0.0;
  std::size_t count = 0;
  double mean() const { return sum / static_cast<double>(count); }
};

template <class Things>
std::size_t named(const Things& things, const std::string& name, const std::string& where) {
  for (std::size_t i = 0; i < things.size(); ++i) {
    if (things[i].name == name) return i;
  }
  throw std::runtime_error(fmt::format("{}: '{}' is no name of the garment's", where, name));
}

template <class Number>
Number number_of(const std::string& text, const std::string& where, const char* expected) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size()) {
    throw std::runtime_error(fmt::format("{}: '{}', expected {}", where, text, expected));
  }
  return value;
}

}  // namespace

std::vector<KnownSourceDistance> read_source_distances(const std::filesystem::path& file,
                                                       const Garment& garment) {
  std::ifstream in(file);
  if (!in) throw std::runtime_error(fmt::format("'{}' cannot be read", file.string()));
  std::vector<KnownSourceDistance> known;
  std::string line;
  std::size_t number = 0;
  while (std::getline(in, line)) {
    ++number;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    const std::string where = fmt::format("{}:{}", file.string(), number);
    if (number == 1) {
      if (line != "placement,source,board,distance_m") {
        throw std::runtime_error(where + ": expected placement,source,board,distance_m");
      }
      continue;
    }
    if (line.empty() || line[0] == '#') continue;
    std::vector<std::string> fields(1);
    for (const char c : line) {
      if (c == ',') {
        fields.emplace_back();
      } else {
        fields.back() += c;
      }
    }
    if (fields.size() != 4) throw std::runtime_error(where + ": expected four fields");
    KnownSourceDistance entry;
    entry.placement = number_of<std::size_t>(fields[0], where, "a placement's number");
    entry.source = named(garment.sources, fields[1], where);
    entry.board = named(garment.boards, fields[2], where);
    entry.distance = number_of<double>(fields[3], where, "a distance in metres");
    if (!(entry.distance >= kNearest && entry.distance <= kFarthest)) {
      throw std::runtime_error(
          fmt::format("{}: {} m, expected {} to {} m", where, entry.distance, kNearest, kFarthest));
    }
    known.push_back(entry);
  }
  if (known.empty()) {
    throw std::runtime_error(fmt::format("{}: expected one distance at least", file.string()));
  }
  return known;
}

PlacementArrivals::PlacementArrivals(std::size_t sources, std::size_t boards)
    : boards_(boards), sent_(sources), arrivals_(sources * boards) {}

void PlacementArrivals::add(std::size_t source, std::span<const std::optional<Arrival>> arrivals) {
  ++sent_.at(source);
  for (std::size_t b = 0; b < std::min(boards_, arrivals.size()); ++b) {
    if (arrivals[b]) arrivals_[source * boards_ + b].push_back(*arrivals[b]);
  }
}

std::optional<PlacementArrivals::Heard> PlacementArrivals::heard(std::size_t source,
                                                                 std::size_t board) const {
  const auto& all = arrivals_.at(source * boards_ + board);
  if (all.size() < kLeastPulses || 2 * all.size() < sent_[source]) return std::nullopt;
  std::vector<double> inflections, peaks;
  for (const Arrival& arrival : all) {
    inflections.push_back(arrival.inflection);
    peaks.push_back(arrival.peak);
  }
  return Heard{median(inflections), median(peaks), all.size()};
}

tl::expected<SourceOffsets, WearableRefusal> solve_source_offsets(
    const Garment& garment, std::span<const PlacementArrivals> placements,
    std::span<const KnownSourceDistance> known, double temperature) {
  SourceOffsets result;
  std::vector<Row> rows;
  for (const auto& entry : known) {
    if (entry.placement >= placements.size()) continue;
    const auto heard = placements[entry.placement].heard(entry.source, entry.board);
    if (!heard) {
      ++result.unheard;
      continue;
    }
    rows.push_back({entry.placement, entry.source, entry.distance, heard->inflection, heard->peak});
  }
  const double samples_per_metre = garment.sample_rate_hz / speed_of_sound(temperature);
  const auto offset_of = [&](std::size_t source, std::optional<std::size_t> without) {
    Offset offset;
    for (const Row& row : rows) {
      if (row.source != source || row.placement == without) continue;
      offset.sum += row.inflection - row.distance * samples_per_metre;
      ++offset.count;
    }
    return offset;
  };

  std::string missing;
  for (std::size_t s = 0; s < garment.sources.size(); ++s) {
    std::set<std::size_t> at;
    for (const Row& row : rows) {
      if (row.source == s) at.insert(row.placement);
    }
    if (at.size() < 2) {
      missing +=
          fmt::format("{}{} ({})", missing.empty() ? "" : ", ", garment.sources[s].name, at.size());
    }
  }
  if (!missing.empty()) {
    return tl::unexpected(WearableRefusal{
        fmt::format("sources that were heard over known distances at fewer than two placements: "
                    "{}; place a microphone 30 to 90 cm before them",
                    missing)});
  }

  for (std::size_t s = 0; s < garment.sources.size(); ++s) {
    const Offset offset = offset_of(s, {});
    std::vector<double> strengths;
    for (const Row& row : rows) {
      if (row.source == s) strengths.push_back(row.peak * row.distance * row.distance);
    }
    result.sources.push_back({{offset.mean(), median(strengths)}, offset.count});
  }
  for (const Row& row : rows) {
    const Offset others = offset_of(row.source, row.placement);
    const double distance = (row.inflection - others.mean()) / samples_per_metre;
    result.left_out.push_back(std::abs(distance - row.distance));
  }
  const auto n = static_cast<double>(result.left_out.size());
  for (const double error : result.left_out) result.left_out_mean += error / n;
  double square = 0.0;
  for (const double error : result.left_out) {
    square += (error - result.left_out_mean) * (error - result.left_out_mean);
  }
  result.left_out_sd = std::sqrt(square / std::max(1.0, n - 1.0));

  // Samples a metre from the distances themselves, each source with its own offset: the slope of
  // what is left of distance and inflection without the source's means.
  double dd = 0.0, dn = 0.0, nn = 0.0;
  for (const Row& row : rows) {
    double mean_d = 0.0, mean_n = 0.0, count = 0.0;
    for (const Row& other : rows) {
      if (other.source != row.source) continue;
      mean_d += other.distance;
      mean_n += other.inflection;
      ++count;
    }
    const double d = row.distance - mean_d / count, i = row.inflection - mean_n / count;
    dd += d * d;
    dn += d * i;
    nn += i * i;
  }
  const auto spare = n - static_cast<double>(garment.sources.size()) - 1.0;
  const double slope = dd > 0.0 ? dn / dd : samples_per_metre;
  const double sigma =
      dd > 0.0 && spare > 0.0 ? std::sqrt(std::max(0.0, nn - slope * dn) / spare / dd) : 0.0;
  const double c = garment.sample_rate_hz / slope;
  const double ratio = c / 331.3;
  result.implied_temperature = 273.15 * (ratio * ratio - 1.0);
  result.implied_sigma = 2.0 * 273.15 * ratio * ratio * sigma / slope;
  return result;
}

}  // namespace secondskin::server
