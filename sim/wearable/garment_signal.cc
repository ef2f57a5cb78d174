#include "sim/wearable/garment_signal.h"

#include <algorithm>
#include <boost/random/normal_distribution.hpp>
#include <cmath>
#include <limits>

#include "sim/wearable/acoustics.h"

namespace secondskin::sim {
namespace {

constexpr std::size_t kSlotsOfEchoes = 3;  // after which nothing is heard any more
constexpr double kHandBefore = 0.003;      // amplitude of a blocked source
constexpr double kTooLoud = 40.0;          // gain of an amplifier gone wrong
constexpr double kDigitalLowPass = 20e3;   // of the digital stream's driver [Hz]
constexpr double kHumLowPass = 8e3;        // of a noise burst in its band [Hz]
constexpr double kHumLevel = 2.5;          // its standard deviation, of the digital level
constexpr double kToneSeconds = 0.005;
constexpr double kPi = std::numbers::pi;

float share(double cutoff_hz, double rate_hz) noexcept {
  return static_cast<float>(1.0 - std::exp(-2.0 * kPi * cutoff_hz / rate_hz));
}

}  // namespace

GarmentSignal::GarmentSignal(const GarmentScene& scene, std::uint64_t seed,
                             const SignalOptions& options)
    : scene_(scene), options_(options) {
  const Garment& garment = scene.garment();
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  for (std::size_t i = 0; i < garment.sources.size(); ++i) {
    Transducer transducer;
    const double spread = options.transducer_spread;
    transducer.bandwidth *= 1.0 + 0.08 * spread * std::clamp(normal(random), -2.0, 2.0);
    transducer.detuning = 150.0 * spread * std::clamp(normal(random), -2.0, 2.0);
    transducer.start_samples =
        std::max(0.0, 2.0 * options.start_spread + options.start_spread * normal(random));
    transducers_.push_back(transducer);
    pulses_.emplace_back(transducer, garment.carrier_hz, garment.sample_rate_hz);
  }
  for (const SensorBoard& board : garment.boards) {
    gains_.push_back(1.0 + options.gain_spread * std::clamp(normal(random), -3.0, 3.0));
    const double period = garment.sample_rate_hz / garment.inertial_rate_hz *
                          (1.0 + 1e-6 * options.clock_ppm * normal(random));
    sensors_.emplace_back(board, scene.errors(), random(), false);
    wires_.push_back({InertialEncoder(period, options.inertial_start, random()),
                      std::vector<float>(kSlotsOfEchoes * garment.slot_samples)});
  }
  for (Felt& felt : felt_) felt.boards.resize(garment.boards.size());
  random_.seed(static_cast<Random::result_type>(random()));
}

wire::GarmentStreamHeader GarmentSignal::header() const {
  const Garment& garment = scene_.garment();
  wire::GarmentStreamHeader header;
  header.garment = garment.name;
  header.boards = static_cast<std::uint16_t>(garment.boards.size());
  header.sources = static_cast<std::uint16_t>(garment.sources.size());
  header.slot_samples = static_cast<std::uint16_t>(garment.slot_samples);
  header.start_ns = options_.start_ns;
  header.sample_rate_hz = garment.sample_rate_hz;
  header.inertial_rate_hz = garment.inertial_rate_hz;
  header.carrier_hz = garment.carrier_hz;
  header.temperature = options_.temperature;
  return header;
}

std::uint32_t GarmentSignal::slots() const noexcept {
  return static_cast<std::uint32_t>(scene_.duration() / scene_.garment().slot());
}

std::size_t GarmentSignal::board_at_channel(std::size_t channel) const noexcept {
  for (const auto& [a, b] : options_.faults.swapped) {
    if (channel == a) return b;
    if (channel == b) return a;
  }
  return channel;
}

// Most boards sample at the same time; a slot has two such times at most.
const BoardTruth& GarmentSignal::felt(std::size_t board, std::int64_t sample) {
  for (Felt& felt : felt_) {
    if (felt.sample == sample) return felt.boards[board];
  }
  Felt& oldest = felt_[0].sample < felt_[1].sample ? felt_[0] : felt_[1];
  oldest.sample = sample;
  scene_.boards_at(static_cast<double>(sample) / scene_.garment().sample_rate_hz, oldest.boards);
  return oldest.boards[board];
}

void GarmentSignal::take(std::size_t board, std::int64_t sample) {
  const Garment& garment = scene_.garment();
  server::BoardReading reading;
  sensors_[board].read(felt(board, sample), 1.0 / garment.inertial_rate_hz, reading);
  InertialEncoder::Values values;
  for (Eigen::Index i = 0; i < 3; ++i) {
    const auto k = static_cast<std::size_t>(i);
    values[k] = reading.gyro[i] / garment.boards[board].gyro_range;
    values[3 + k] = reading.accel[i] / garment.boards[board].accel_range;
  }
  wires_[board].encoder.take(values);
}

void GarmentSignal::add_sound(double time) {
  const Garment& garment = scene_.garment();
  if (garment.sources.empty()) return;
  const std::size_t source = slot_ % garment.sources.size();
  const double c = speed_of_sound(options_.temperature + options_.faults.temperature_error);
  double loudness = options_.loudness;
  if (any_holds(options_.faults.blocked, source, time)) loudness *= kHandBefore;
  const double start = transducers_[source].start_samples;
  scene_.at(time + start / garment.sample_rate_hz, instant_);
  const auto reflectors = options_.echoes ? scene_.reflectors() : std::span<const Reflector>{};
  SoundPaths paths;
  for (std::size_t board = 0; board < wires_.size(); ++board) {
    std::size_t count =
        sound_paths(instant_, reflectors, source, board, c, garment.carrier_hz, paths);
    if (!options_.echoes) count = 1;
    for (std::size_t i = 0; i < count; ++i) {
      pulses_[source].add(start + paths[i].delay * garment.sample_rate_hz,
                          loudness * gains_[board] * paths[i].amplitude, paths[i].pace,
                          wires_[board].sound);
    }
  }
}

void GarmentSignal::add_tones() {
  const Garment& garment = scene_.garment();
  std::uniform_real_distribution<double> uniform;
  const double begin = static_cast<double>(slot_) * static_cast<double>(garment.slot_samples);
  const double end = begin + static_cast<double>(garment.slot_samples);
  if (uniform(random_) < options_.tones_hz * garment.slot()) {
    const double from = begin + uniform(random_) * (end - begin);
    const double hz = 20e3 + 40e3 * uniform(random_);
    tones_.push_back({from, from + kToneSeconds * garment.sample_rate_hz,
                      2.0 * kPi * hz / garment.sample_rate_hz, 2.0 * kPi * uniform(random_),
                      static_cast<float>(options_.tone_level * uniform(random_))});
  }
  std::erase_if(tones_, [&](const Tone& tone) { return tone.end < begin; });
  for (const Tone& tone : tones_) {
    for (std::size_t i = 0; i < garment.slot_samples; ++i) {
      const double at = begin + static_cast<double>(i);
      if (at < tone.begin || at >= tone.end) continue;
      const float value = tone.level * static_cast<float>(std::sin(tone.turn * at + tone.phase));
      for (Wire& wire : wires_) wire.sound[i] += value;
    }
  }
}

void GarmentSignal::digitise(std::size_t channel, std::span<std::int16_t> out) {
  const Garment& garment = scene_.garment();
  const std::size_t board = board_at_channel(channel);
  Wire& wire = wires_[board];
  const double time = static_cast<double>(slot_) * garment.slot();
  const auto first =
      static_cast<std::int64_t>(slot_) * static_cast<std::int64_t>(garment.slot_samples);
  const bool silent = any_holds(options_.faults.silent, channel, time);
  const bool humming = any_holds(options_.faults.bit_errors, channel, time);
  const auto gain =
      static_cast<float>(any_holds(options_.faults.gain, channel, time) ? kTooLoud : 1.0);
  const auto noise = static_cast<float>(options_.noise);
  const auto digital = static_cast<float>(options_.digital);
  boost::random::normal_distribution<float> normal;  // a ziggurat: keeps nothing
  const float smooth = share(kDigitalLowPass, garment.sample_rate_hz);
  const float hum_smooth = share(kHumLowPass, garment.sample_rate_hz);
  // A one-pole low-pass of white noise leaves k / (2 - k) of its power.
  const auto hum = static_cast<float>(kHumLevel * options_.digital) *
                   std::sqrt((2.0F - hum_smooth) / hum_smooth);
  constexpr float kLowest = std::numeric_limits<std::int16_t>::min();
  constexpr float kHighest = std::numeric_limits<std::int16_t>::max();
  for (std::size_t i = 0; i < out.size(); ++i) {
    if (wire.encoder.due()) take(board, first + static_cast<std::int64_t>(i));
    wire.level += smooth * (digital * wire.encoder.next() - wire.level);
    float value = wire.level + wire.sound[i];
    if (noise > 0.0F) value += noise * normal(random_);
    if (humming) {
      wire.hum += hum_smooth * (hum * normal(random_) - wire.hum);
      value += wire.hum;
    }
    out[i] = static_cast<std::int16_t>(std::lrint(std::clamp(gain * value, kLowest, kHighest)));
  }
  if (silent) std::fill(out.begin(), out.end(), std::int16_t{0});
  std::move(wire.sound.begin() + static_cast<std::ptrdiff_t>(out.size()), wire.sound.end(),
            wire.sound.begin());
  std::fill(wire.sound.end() - static_cast<std::ptrdiff_t>(out.size()), wire.sound.end(), 0.0F);
}

void GarmentSignal::next(std::span<std::int16_t> samples) {
  const Garment& garment = scene_.garment();
  add_sound(static_cast<double>(slot_) * garment.slot());
  add_tones();
  for (std::size_t channel = 0; channel < wires_.size(); ++channel) {
    digitise(channel, samples.subspan(channel * garment.slot_samples, garment.slot_samples));
  }
  ++slot_;
}

}  // namespace secondskin::sim
