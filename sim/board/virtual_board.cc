#include "sim/board/virtual_board.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace secondskin::sim {
namespace {

using wire::Actuator;
using wire::ActuatorResponse;
using wire::kTactorCount;

constexpr double kFullVoltage = 5.0;         // 4.1 [V]
constexpr double kStep = 0.001;              // actuators against a pulsing drive [s]
constexpr double kLongestTrace = 1.0;        // ten times the slowest actuator's memory [s]
constexpr double kFaintestVibration = 1e-3;  // below, an actuator counts as at rest

template <std::size_t... I>
std::array<ActuatorResponse, kTactorCount> make_actuators(
    const std::array<Actuator, kTactorCount>& kinds, std::index_sequence<I...>) noexcept {
  return {ActuatorResponse(kinds[I])...};
}

}  // namespace

VirtualBoard::VirtualBoard(const VirtualBoardConfig& config, double now)
    : watchdog_(config.watchdog),
      now_(now),
      last_byte_(now),
      actuators_(make_actuators(config.actuators, std::make_index_sequence<kTactorCount>())) {
  if (!(watchdog_ > 0.0)) {
    throw std::invalid_argument("virtual board: watchdog must be a positive time, in seconds");
  }
}

void VirtualBoard::receive(std::span<const std::uint8_t> bytes, double now) noexcept {
  step(now);
  if (bytes.empty()) return;
  last_byte_ = now_;
  bytes_ += bytes.size();
  for (const std::uint8_t byte : bytes) {
    if (const auto command = parser_.push(byte, now_)) {
      ++commands_;
      patterns_.apply(*command, now_);
    }
  }
  patterns_.drive(now_, drive_);
}

void VirtualBoard::step(double now) noexcept {
  if (slots_on() > 0 && now - last_byte_ >= watchdog_) {
    advance(std::max(now_, last_byte_ + watchdog_));
    patterns_.all_off();
    ++watchdog_trips_;
  }
  advance(now);
  patterns_.drive(now_, drive_);
}

void VirtualBoard::advance(double now) noexcept {
  if (!(now > now_)) return;
  const bool on = slots_on() > 0;
  double time = on ? std::max(now_, now - kLongestTrace) : now_;
  std::array<double, kTactorCount> level{};
  while (time < now) {
    const double dt = on ? std::min(kStep, now - time) : now - time;
    patterns_.drive(time, level);
    for (std::size_t i = 0; i < kTactorCount; ++i) {
      amplitude_[i] = actuators_[i].step(level[i], dt);
    }
    const double next = time + dt;
    if (!(next > time)) break;  // a step below the clock's resolution
    time = next;
  }
  now_ = now;
}

std::size_t VirtualBoard::slots_on() const noexcept {
  const auto& state = patterns_.state();
  return state.size() -
         static_cast<std::size_t>(std::count(state.begin(), state.end(), std::uint8_t{0}));
}

bool VirtualBoard::active() const noexcept {
  return slots_on() > 0 || std::any_of(amplitude_.begin(), amplitude_.end(),
                                       [](double a) { return a > kFaintestVibration; });
}

VirtualBoardCounters VirtualBoard::counters() const noexcept {
  return {bytes_, commands_, parser_.dropped_bytes(), watchdog_trips_};
}

double voltage_of(Actuator actuator, double drive, double time) noexcept {
  if (actuator == Actuator::kDcMotor) return kFullVoltage * drive;
  const double cycles = time * wire::kVoiceCoilFrequency;
  const bool high = cycles - std::floor(cycles) < 0.5;
  return (high ? 0.5 : -0.5) * kFullVoltage * drive;
}

std::string bars(std::span<const double, kTactorCount> levels) {
  std::string line(kTactorCount, '.');
  for (std::size_t i = 0; i < kTactorCount; ++i) {
    if (levels[i] > 0.0) {
      line[i] = static_cast<char>('0' + std::clamp(static_cast<int>(levels[i] * 9.0 + 0.5), 1, 9));
    }
  }
  return line;
}

}  // namespace secondskin::sim
