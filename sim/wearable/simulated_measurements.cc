#include "sim/wearable/simulated_measurements.h"

#include <algorithm>
#include <cmath>

#include "sim/wearable/acoustics.h"

namespace secondskin::sim {
namespace {

// Power of the pulse, of that on the source's normal in the open at the same distance: at least
// this is as strong as any (w_s = 1, section 4.1), below the lower one is not told from echoes.
constexpr double kStrong = 0.002;
constexpr double kWeak = 0.0001;
// Amplitude at 1 m on the normal, of the noise in the receiver's band.
constexpr double kSignalToNoise = 1500.0;
constexpr double kHeard = 4.0;      // of the noise: "well above" it
constexpr double kJump = 0.10;      // of a distance within a round that is still continuous [m]
constexpr double kEchoMean = 0.35;  // how much longer an echo's way is [m]

std::int64_t ns(double seconds) noexcept { return std::llround(seconds * 1e9); }

double normal(std::mt19937_64& random, double sigma) {
  return sigma * std::normal_distribution<double>()(random);
}

}  // namespace

SimulatedMeasurements::SimulatedMeasurements(const GarmentScene& worn, std::uint64_t seed,
                                             const MeasurementOptions& options)
    : worn_(worn), seed_(seed), options_(options) {
  rewind();
}

bool SimulatedMeasurements::rewind() {
  const Garment& garment = worn_.garment();
  random_.seed(seed_);
  sensors_.clear();
  for (const SensorBoard& board : garment.boards) {
    sensors_.emplace_back(board, worn_.errors(), random_(), options_.codec);
  }
  truth_.resize(garment.boards.size());
  shadows_.resize(garment.boards.size());
  last_.assign(garment.sources.size() * garment.boards.size(), NAN);
  samples_ = slots_ = 0;
  return true;
}

std::size_t SimulatedMeasurements::board_at_channel(std::size_t channel) const noexcept {
  for (const auto& [a, b] : options_.faults.swapped) {
    if (channel == a) return b;
    if (channel == b) return a;
  }
  return channel;
}

server::Next SimulatedMeasurements::next(server::Measurement& measurement) {
  const Garment& garment = worn_.garment();
  const double sampled = static_cast<double>(samples_) / garment.inertial_rate_hz;
  const double sent = static_cast<double>(slots_) * garment.slot();
  const bool sounding = options_.distances && !garment.sources.empty();
  if (sounding && sent + garment.slot() < sampled) {
    if (sent + garment.slot() > worn_.duration()) return server::Next::kEnd;
    distances(sent, measurement);
    ++slots_;
    return server::Next::kPose;
  }
  if (sampled > worn_.duration()) return server::Next::kEnd;
  inertial(sampled, measurement);
  ++samples_;
  return server::Next::kPose;
}

void SimulatedMeasurements::inertial(double time, server::Measurement& out) {
  const Garment& garment = worn_.garment();
  out.kind = server::MeasurementKind::kInertial;
  out.stamp_ns = options_.start_ns + ns(time);
  out.boards.resize(garment.boards.size());
  out.distances.clear();
  worn_.boards_at(time, truth_);
  for (std::size_t channel = 0; channel < truth_.size(); ++channel) {
    const std::size_t board = board_at_channel(channel);
    server::BoardReading& reading = out.boards[channel];
    sensors_[board].read(truth_[board], 1.0 / garment.inertial_rate_hz, reading);
    if (any_holds(options_.faults.silent, channel, time) ||
        any_holds(options_.faults.bit_errors, channel, time)) {
      reading = {};
    }
  }
}

void SimulatedMeasurements::distances(double time, server::Measurement& out) {
  const Garment& garment = worn_.garment();
  out.kind = server::MeasurementKind::kDistances;
  out.stamp_ns = options_.start_ns + ns(time);
  out.boards.clear();
  out.source = static_cast<std::size_t>(slots_ % garment.sources.size());
  out.distances.resize(garment.boards.size());
  worn_.at(time, instant_);
  const double c = speed_of_sound(options_.temperature + options_.faults.temperature_error);
  shadows(instant_, out.source, c / garment.carrier_hz, shadows_);
  for (std::size_t channel = 0; channel < out.distances.size(); ++channel) {
    const std::size_t board = board_at_channel(channel);
    server::DistanceReading& reading = out.distances[channel];
    reading = distance(out.source, board, time, shadows_[board]);
    double& last = last_[out.source * out.distances.size() + channel];
    if (any_holds(options_.faults.silent, channel, time)) reading = {};
    if (!(reading.confidence > 0.0)) continue;
    // w_t of section 4.1: falls to zero as the jump grows.
    const double jump = std::abs(reading.distance - last);
    if (jump > kJump) reading.confidence *= std::max(0.0, 2.0 - jump / kJump);
    last = reading.distance;
  }
}

server::DistanceReading SimulatedMeasurements::distance(std::size_t source, std::size_t board,
                                                        double time, const Shadow& shadow) {
  const double assumed_c = speed_of_sound(options_.temperature);
  const double c = speed_of_sound(options_.temperature + options_.faults.temperature_error);
  const Eigen::Isometry3d& X_WU = instant_.sources[source];
  const BoardTruth& S = instant_.boards[board];
  // The microphone moves on while the sound is on its way; a jerk of a body moves it by less than
  // 0.1 mm more.
  double flight = 0.0;
  Eigen::Vector3d way;
  for (int i = 0; i < 3; ++i) {
    way = S.X_WS.translation() + flight * S.v + 0.5 * flight * flight * S.a - X_WU.translation();
    flight = (way.norm() + shadow.detour) / c;
  }
  const double length = std::max(0.01, way.norm());
  double strength = directivity(X_WU.linear().col(2).dot(way) / length) * shadow.amplitude;
  if (any_holds(options_.faults.blocked, source, time)) strength *= 0.01;
  const double heard = kSignalToNoise * strength * spread(length);
  const double noise =
      normal(random_, worn_.errors().distance_noise * std::sqrt(1.0 + 400.0 / (heard * heard)));
  const double echo =
      -kEchoMean * std::log(1.0 - std::uniform_real_distribution<double>()(random_));
  const bool taken = std::uniform_real_distribution<double>()(random_) < options_.echo_share;

  server::DistanceReading reading;
  const double power = strength * strength;
  double travelled = flight * c;
  if (heard < kHeard || power < kWeak) {
    if (!taken) return reading;  // nothing that could be a pulse
    travelled += 0.05 + echo;
    reading.confidence = 0.1;
  } else {
    // w_s of section 4.1: 1 above the threshold, below it as the squared inverse of what lacks.
    const double lacks = std::max(0.0, (kStrong - power) / (0.3 * kStrong));
    reading.confidence = 1.0 / (1.0 + lacks * lacks);
  }
  if (travelled > assumed_c * worn_.garment().slot()) return {};  // the next pulse is out
  reading.distance = travelled * assumed_c / c + noise;
  return reading;
}

}  // namespace secondskin::sim
