#include "server/wearable/start/rest_finder.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace secondskin::server {
namespace {

constexpr double kFurthestOnBody = 1.7;       // of a source from a board [m]
constexpr std::int64_t kBlock = 100'000'000;  // [ns]
constexpr std::int64_t kGap = 300'000'000;    // silence that ends a rest [ns]

Eigen::Vector3d mean(const Eigen::Vector3d& sum, std::size_t count) {
  return sum / static_cast<double>(std::max<std::size_t>(count, 1));
}

double seconds(std::int64_t begin_ns, std::int64_t end_ns) {
  return 1e-9 * static_cast<double>(end_ns - begin_ns);
}

}  // namespace

Hearing::Hearing(const Garment& garment)
    : heard_(Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(garment.sources.size()),
                                   static_cast<Eigen::Index>(garment.boards.size()))),
      pulses_(Eigen::VectorXd::Zero(heard_.rows())) {
  for (const UltrasonicSource& source : garment.sources) {
    furthest_.push_back(source.segment ? kFurthestOnBody : std::numeric_limits<double>::infinity());
  }
}

bool Hearing::counts(std::size_t source, const DistanceReading& reading,
                     double confidence) const noexcept {
  return reading.confidence >= confidence && source < furthest_.size() &&
         reading.distance <= furthest_[source];
}

void Hearing::add(const Measurement& measurement, double confidence) {
  const auto source = static_cast<Eigen::Index>(measurement.source);
  if (measurement.kind != MeasurementKind::kDistances || source >= pulses_.size()) return;
  pulses_[source] += 1.0;
  for (Eigen::Index b = 0; b < heard_.cols(); ++b) {
    const auto i = static_cast<std::size_t>(b);
    if (i < measurement.distances.size() &&
        counts(measurement.source, measurement.distances[i], confidence)) {
      heard_(source, b) += 1.0;
    }
  }
}

Eigen::MatrixXd Hearing::shares() const {
  return pulses_.cwiseMax(1.0).cwiseInverse().asDiagonal() * heard_;
}

RestFinder::RestFinder(const Garment& garment, const RestSettings& settings)
    : settings_(settings),
      boards_(garment.boards.size()),
      sources_(garment.sources.size()),
      silence_(garment),
      hearing_(garment) {
  sum_.resize(boards_);
}

bool RestFinder::add(const Measurement& measurement) {
  if (over_) return true;
  if (measurement.kind == MeasurementKind::kDistances) {
    hearing_.add(measurement, settings_.confidence);
    for (std::size_t b = 0; b < std::min(boards_, measurement.distances.size()); ++b) {
      const auto& reading = measurement.distances[b];
      if (hearing_.counts(measurement.source, reading, settings_.confidence)) {
        block_.distances.push_back({measurement.source, b, reading.distance});
      }
    }
    return false;
  }
  if (!block_.boards.empty() && measurement.stamp_ns - block_.begin_ns >= kBlock) {
    if (close_block()) return true;
  }
  if (!run_.empty() && measurement.stamp_ns - run_.back().end_ns > kGap + kBlock) {
    run_.clear();
    std::fill(sum_.begin(), sum_.end(), Sum{});
    hearing_ = silence_;
  }
  if (block_.boards.empty()) {
    block_.boards.resize(boards_);
    block_.begin_ns = measurement.stamp_ns;
  }
  block_.end_ns = measurement.stamp_ns;
  for (std::size_t b = 0; b < std::min(boards_, measurement.boards.size()); ++b) {
    const BoardReading& reading = measurement.boards[b];
    Sum& sum = block_.boards[b];
    if (reading.gyro_valid && reading.gyro.allFinite()) {
      sum.gyro += reading.gyro;
      ++sum.gyros;
    }
    if (reading.accel_valid && reading.accel.allFinite()) {
      sum.accel += reading.accel;
      ++sum.accels;
    }
    if (reading.magnetic_valid && reading.magnetic.allFinite()) {
      sum.magnetic += reading.magnetic;
      ++sum.magnetics;
    }
  }
  return false;
}

bool RestFinder::strays(const Block& block) const {
  std::size_t felt = 0, stray = 0;
  for (std::size_t b = 0; b < boards_; ++b) {
    const Sum &now = block.boards[b], &all = sum_[b];
    if (now.gyros + now.accels == 0) continue;
    ++felt;
    bool off = now.gyros > 0 && mean(now.gyro, now.gyros).norm() > settings_.turning;
    if (now.gyros > 0 && all.gyros > 0) {
      off |= (mean(now.gyro, now.gyros) - mean(all.gyro, all.gyros)).norm() > settings_.gyro;
    }
    if (now.accels > 0 && all.accels > 0) {
      off |= (mean(now.accel, now.accels) - mean(all.accel, all.accels)).norm() > settings_.accel;
    }
    stray += off ? 1 : 0;
  }
  return felt == 0 ||
         static_cast<double>(stray) > settings_.disobedient * static_cast<double>(felt);
}

// @returns whether the rest is over.
bool RestFinder::close_block() {
  const bool moved = strays(block_);
  if (moved && !run_.empty()) {
    // The last block may hold the movement's beginning.
    const double length = seconds(run_.front().begin_ns, run_.back().begin_ns);
    if (length >= settings_.shortest) {
      run_.pop_back();
      over_ = true;
      return true;
    }
    run_.clear();
    std::fill(sum_.begin(), sum_.end(), Sum{});
    hearing_ = silence_;
  }
  // What moved against the run before may be the first of another.
  if (!moved || !strays(block_)) {
    run_.push_back(std::move(block_));
    for (std::size_t b = 0; b < boards_; ++b) {
      const Sum& now = run_.back().boards[b];
      sum_[b].gyro += now.gyro;
      sum_[b].accel += now.accel;
      sum_[b].gyros += now.gyros;
      sum_[b].accels += now.accels;
    }
  }
  block_ = {};
  if (run_.empty()) return false;
  over_ = seconds(run_.front().begin_ns, run_.back().end_ns) >= settings_.longest;
  return over_;
}

std::optional<Rest> RestFinder::rest() const {
  if (run_.empty()) return std::nullopt;
  Rest rest;
  rest.begin_ns = run_.front().begin_ns;
  rest.end_ns = run_.back().end_ns;
  // A run that something ended has lost a block, which its length was checked with.
  if (!over_ && seconds(rest.begin_ns, rest.end_ns) < settings_.shortest) return std::nullopt;
  rest.boards.resize(boards_);
  for (std::size_t b = 0; b < boards_; ++b) {
    BoardRest& board = rest.boards[b];
    Sum all;
    for (const Block& block : run_) {
      all.gyro += block.boards[b].gyro;
      all.accel += block.boards[b].accel;
      all.gyros += block.boards[b].gyros;
      all.accels += block.boards[b].accels;
      all.magnetic += block.boards[b].magnetic;
      all.magnetics += block.boards[b].magnetics;
    }
    board.gyro = mean(all.gyro, all.gyros);
    board.accel = mean(all.accel, all.accels);
    board.magnetic = mean(all.magnetic, all.magnetics);
    board.magnetic_readings = all.magnetics;
    board.gyro_readings = all.gyros;
    board.accel_readings = all.accels;
    double gyro = 0.0, accel = 0.0;
    for (const Block& block : run_) {
      const Sum& sum = block.boards[b];
      if (sum.gyros > 0) gyro += (mean(sum.gyro, sum.gyros) - board.gyro).squaredNorm() / 3.0;
      if (sum.accels > 0) accel += (mean(sum.accel, sum.accels) - board.accel).squaredNorm() / 3.0;
    }
    const auto blocks = static_cast<double>(run_.size());
    board.gyro_deviation = std::sqrt(gyro / blocks);
    board.accel_deviation = std::sqrt(accel / blocks);
  }
  rest.heard = hearing_.shares();
  rest.distances.setConstant(static_cast<Eigen::Index>(sources_),
                             static_cast<Eigen::Index>(boards_),
                             std::numeric_limits<double>::quiet_NaN());
  std::vector<std::vector<double>> heard(sources_ * boards_);
  for (const Block& block : run_) {
    for (const auto& one : block.distances) {
      if (one.source < sources_) heard[one.source * boards_ + one.board].push_back(one.distance);
    }
  }
  for (std::size_t i = 0; i < heard.size(); ++i) {
    if (heard[i].size() < 3) continue;
    const auto middle = heard[i].begin() + static_cast<std::ptrdiff_t>(heard[i].size() / 2);
    std::nth_element(heard[i].begin(), middle, heard[i].end());
    rest.distances(static_cast<Eigen::Index>(i / boards_), static_cast<Eigen::Index>(i % boards_)) =
        *middle;
  }
  return rest;
}

}  // namespace secondskin::server
