#pragma once

#include <random>
#include <vector>

#include "sim/wearable/garment_faults.h"
#include "sim/wearable/inertial_encoder.h"
#include "sim/wearable/inertial_sensor.h"
#include "sim/wearable/sound_paths.h"
#include "sim/wearable/ultrasonic_pulse.h"
#include "wire/garment_stream.h"

/// What the driver box samples of each board's wire: the microphone's ultrasound and the digital
/// stream, added (Practical Motion Capture, 3.1 to 3.3). docs/wearable-hardware.md has the model.
namespace secondskin::sim {

/// Levels in counts of the 16-bit converter.
struct SignalOptions {
  double loudness = 4800.0;        ///< of a pulse at 1 m on the source's normal
  double digital = 300.0;          ///< of the digital stream
  double noise = 6.0;              ///< standard deviation, white
  double tones_hz = 0.0;           ///< foreign tone bursts a second (keys, brakes), 0: none
  double tone_level = 300.0;       ///< of them, at most
  bool echoes = true;              ///< floor, walls, limbs
  double gain_spread = 0.1;        ///< relative standard deviation of the boards' gains
  double start_spread = 2.0;       ///< standard deviation of the sources' starts [samples]
  double transducer_spread = 1.0;  ///< of bandwidths and detunings, 1: 8 % and 150 Hz
  double inertial_start = 300.0;   ///< first inertial sample of all boards [samples]
  double clock_ppm = 0.0;          ///< standard deviation of the boards' clocks; 0: the box polls
  double temperature = 20.0;       ///< as the box measures it [deg C]
  std::int64_t start_ns = 0;       ///< stamp of the first sample
  GarmentFaults faults;
};

/// Deterministic for a seed; slot after slot. One thread.
class GarmentSignal {
 public:
  /// @param scene  borrowed
  GarmentSignal(const GarmentScene& scene, std::uint64_t seed, const SignalOptions& options = {});

  wire::GarmentStreamHeader header() const;
  std::uint32_t slots() const noexcept;  ///< whole ones in the scene's time

  /// The next slot of all boards. @param samples  out: channel-major, boards * slot_samples.
  /// Goes on after the scene's end; what moves then is the scene's affair.
  void next(std::span<std::int16_t> samples);

  const std::vector<Transducer>& transducers() const noexcept { return transducers_; }
  const std::vector<double>& gains() const noexcept { return gains_; }  ///< relative, by board
  const std::vector<InertialSensor>& sensors() const noexcept { return sensors_; }

 private:
  using Random = std::mt19937;
  struct Wire {
    InertialEncoder encoder;
    std::vector<float> sound;  ///< this slot and what is still to come of its echoes
    float level = 0.0F;        ///< of the digital stream behind its low-pass
    float hum = 0.0F;          ///< of the noise burst behind its low-pass
  };
  struct Tone {
    double begin, end;  ///< [samples, from the start]
    double turn, phase;
    float level;
  };
  struct Felt {
    std::int64_t sample = -1;
    std::vector<BoardTruth> boards;
  };

  std::size_t board_at_channel(std::size_t channel) const noexcept;
  const BoardTruth& felt(std::size_t board, std::int64_t sample);
  void take(std::size_t board, std::int64_t sample);
  void add_sound(double time);
  void add_tones();
  void digitise(std::size_t channel, std::span<std::int16_t> out);

  const GarmentScene& scene_;
  SignalOptions options_;
  Random random_;
  std::vector<Transducer> transducers_;
  std::vector<UltrasonicPulse> pulses_;
  std::vector<double> gains_;
  std::vector<InertialSensor> sensors_;
  std::vector<Wire> wires_;
  std::vector<Tone> tones_;
  std::array<Felt, 2> felt_;
  GarmentInstant instant_;
  std::uint32_t slot_ = 0;
};

}  // namespace secondskin::sim
