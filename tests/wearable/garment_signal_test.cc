#include "sim/wearable/garment_signal.h"

#include <gtest/gtest.h>

#include <cmath>

#include "motion/retarget.h"
#include "sim/wearable/acoustics.h"
#include "sim/wearable/simulated_measurements.h"
#include "sim/wearable/worn_garment.h"

namespace secondskin::sim {
namespace {

const std::filesystem::path kSource = SECONDSKIN_SOURCE_DIR;

Garment practical() { return Garment::load(kSource / "garments/practical.toml"); }

// One source at the origin that faces along x, and boards that move as they are told.
class Range final : public GarmentScene {
 public:
  explicit Range(std::vector<BoardTruth> boards) : boards_(std::move(boards)) {
    garment_ = practical();
    garment_.boards.resize(boards_.size());
    garment_.sources.resize(1);
  }
  const Garment& garment() const noexcept override { return garment_; }
  const WornErrors& errors() const noexcept override { return errors_; }
  double duration() const noexcept override { return 10.0; }
  void boards_at(double time, std::span<BoardTruth> boards) const noexcept override {
    for (std::size_t i = 0; i < boards.size(); ++i) {
      boards[i] = boards_[i];
      boards[i].X_WS.translation() += time * boards_[i].v;
    }
  }
  void at(double time, GarmentInstant& out) const override {
    out.boards.resize(boards_.size());
    boards_at(time, out.boards);
    out.sources.assign(1, Eigen::Isometry3d(Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitY())));
    out.source_v.assign(1, Eigen::Vector3d::Zero());
    out.limbs = limbs;
  }
  std::span<const Reflector> reflectors() const noexcept override { return walls; }

  std::vector<Limb> limbs;
  std::vector<Reflector> walls;

 private:
  std::vector<BoardTruth> boards_;
  Garment garment_;
  WornErrors errors_ = WornErrors::none();
};

BoardTruth board(double x, double y = 0.0, double v = 0.0) {
  BoardTruth board;
  board.X_WS.translation() = Eigen::Vector3d(x, y, 0.0);
  board.v = {v, 0.0, 0.0};
  board.accel = {0.0, 0.0, kStandardGravity};
  return board;
}

SignalOptions clean() {
  SignalOptions options;
  options.digital = options.noise = options.gain_spread = 0.0;
  options.loudness = 2000.0;
  return options;
}

std::vector<std::int16_t> slots(GarmentSignal& signal, const Garment& garment, int count = 1) {
  std::vector<std::int16_t> samples(garment.boards.size() * garment.slot_samples);
  for (int k = 0; k < count; ++k) signal.next(samples);
  return samples;
}

std::span<const std::int16_t> wire_of(const std::vector<std::int16_t>& samples, std::size_t board) {
  return std::span(samples).subspan(board * 1120, 1120);
}

double power(std::span<const std::int16_t> signal) {
  double sum = 0.0;
  for (const double x : signal) sum += x * x;
  return sum;
}

// Centre of the power: moves with the arrival by the same number of samples.
double centre(std::span<const std::int16_t> signal) {
  double sum = 0.0;
  for (std::size_t i = 0; i < signal.size(); ++i) {
    sum += static_cast<double>(i) * signal[i] * signal[i];
  }
  return sum / power(signal);
}

TEST(UltrasonicPulse, RisesFastestFortySamplesAfterItsSlotBegan) {
  const UltrasonicPulse pulse(Transducer{}, 40e3, 140e3);
  double steepest = 0.0, at = 0.0;
  for (double x = 0.25; x < pulse.length(); x += 0.25) {
    const double rise = std::pow(pulse.envelope(x), 2) - std::pow(pulse.envelope(x - 0.25), 2);
    if (rise > steepest) {
      steepest = rise;
      at = x;
    }
  }
  const double start = 2.0 * SignalOptions{}.start_spread;
  EXPECT_NEAR(at + start, 40.0, 2.0);  // Practical Motion Capture, 4.1
}

TEST(UltrasonicPulse, IsTheSameWhereverBetweenTwoSamplesItBegins) {
  const UltrasonicPulse pulse(Transducer{}, 40e3, 140e3);
  std::vector<float> a(400), b(400);
  pulse.add(10.0, 1000.0, 1.0, a);
  // 7 samples are 2 cycles: the same phase, so the same samples.
  pulse.add(17.0, 1000.0, 1.0, b);
  for (std::size_t i = 0; i + 7 < a.size(); ++i) EXPECT_NEAR(a[i], b[i + 7], 0.1);
  pulse.add(10.5, 1000.0, 1.0, a);
  EXPECT_EQ(a[10], 0.0F);
  for (std::size_t i = 0; i <= 10; ++i) EXPECT_EQ(a[i], 0.0F);
}

TEST(GarmentSignal, ArrivesByItsDistanceOverTheSpeedOfSound) {
  for (const double celsius : {0.0, 20.0, 35.0}) {
    const Range range({board(0.3), board(0.5), board(0.9), board(1.5)});
    SignalOptions options = clean();
    options.temperature = celsius;
    GarmentSignal signal(range, 1, options);
    const auto samples = slots(signal, range.garment());
    const double c = 331.3 * std::sqrt(1.0 + celsius / 273.15);
    const double first = centre(wire_of(samples, 0));
    for (std::size_t i = 0; i < 4; ++i) {
      const double distance = std::array{0.3, 0.5, 0.9, 1.5}[i];
      EXPECT_NEAR(centre(wire_of(samples, i)) - first, (distance - 0.3) / c * 140e3, 0.3);
      // Nothing comes before its time, and something soon after.
      const double begins = signal.transducers()[0].start_samples + distance / c * 140e3;
      const auto sound = wire_of(samples, i);
      std::size_t heard = 0;
      while (sound[heard] == 0) ++heard;
      EXPECT_GE(static_cast<double>(heard), begins);
      EXPECT_LT(static_cast<double>(heard), begins + 15.0);
    }
  }
}

TEST(GarmentSignal, WeakensWithDistanceAndAbsorption) {
  const Range range({board(0.3), board(0.6), board(1.2)});
  GarmentSignal signal(range, 1, clean());
  const auto samples = slots(signal, range.garment());
  const auto amplitude = [&](std::size_t i) { return std::sqrt(power(wire_of(samples, i))); };
  // 1 / r, and 1.3 dB/m.
  EXPECT_NEAR(amplitude(0) / amplitude(1), 2.0 * std::pow(10.0, 1.3 * 0.3 / 20.0), 0.02);
  EXPECT_NEAR(amplitude(0) / amplitude(2), 4.0 * std::pow(10.0, 1.3 * 0.9 / 20.0), 0.04);
}

TEST(GarmentSignal, IsWeakerBesideTheSourcesNormal) {
  const double r = 0.5;
  const Range range({board(r), board(r * std::cos(0.7), r * std::sin(0.7)), board(0.0, r)});
  GarmentSignal signal(range, 1, clean());
  const auto samples = slots(signal, range.garment());
  const double on = std::sqrt(power(wire_of(samples, 0)));
  // Murata MA40S4S: -6 dB at some 40 degrees. The microphones' own pattern adds under 1 dB.
  EXPECT_NEAR(20.0 * std::log10(std::sqrt(power(wire_of(samples, 1))) / on), -6.0, 1.5);
  EXPECT_NEAR(20.0 * std::log10(std::sqrt(power(wire_of(samples, 2))) / on), -22.0, 2.0);
}

TEST(GarmentSignal, ALimbInTheWayWeakensAndDelaysIt) {
  Range range({board(0.6)});
  GarmentSignal open(range, 1, clean());
  const auto direct = slots(open, range.garment());
  range.limbs = {{{0.3, 0.0, -0.5}, {0.3, 0.0, 0.5}, 0.04}};
  GarmentSignal hidden(range, 1, clean());
  const auto behind = slots(hidden, range.garment());
  // ITU-R P.526: nu = h sqrt(2 (d1 + d2) / (lambda d1 d2)) = 1.58, 17.1 dB; the way around is
  // 5 mm longer.
  EXPECT_NEAR(10.0 * std::log10(power(wire_of(behind, 0)) / power(wire_of(direct, 0))), -17.2, 0.3);
  EXPECT_GT(centre(wire_of(behind, 0)), centre(wire_of(direct, 0)) + 1.0);
}

TEST(GarmentSignal, AWallsEchoComesAfterTheDirectSoundAndFromItsImage) {
  Range range({board(0.6)});
  range.walls = {{{0.0, 1.0, 0.0}, -0.4, 0.7}};  // beside, 0.4 m away
  GarmentSignal signal(range, 1, clean());
  const auto samples = slots(signal, range.garment());
  const double c = speed_of_sound(20.0);
  const double direct = 0.6 / c * 140e3, echo = std::hypot(0.6, 0.8) / c * 140e3;
  const auto sound = wire_of(samples, 0);
  const auto at = [&](double from) {
    return power(sound.subspan(static_cast<std::size_t>(from), 60));
  };
  EXPECT_GT(at(direct + 10.0), at(echo + 20.0));
  // Without the wall there is less at the echo's time.
  range.walls.clear();
  GarmentSignal without(range, 1, clean());
  const auto bare = slots(without, range.garment());
  EXPECT_GT(at(echo + 20.0),
            2.0 * power(wire_of(bare, 0).subspan(static_cast<std::size_t>(echo + 20.0), 60)));
}

TEST(GarmentSignal, AnEchoThatIsLateEndsInTheNextSlot) {
  Range range({board(0.6)});
  range.walls = {{{-1.0, 0.0, 0.0}, -1.85, 0.9}};  // ahead: the echo goes 3.1 m, a slot is 2.75 m
  GarmentSignal signal(range, 1, clean());
  (void)slots(signal, range.garment());
  // The second slot has its own pulse at 0.6 m; before that only the first one's echo sounds.
  const auto samples = slots(signal, range.garment());
  const double c = speed_of_sound(20.0);
  const auto begins = static_cast<std::size_t>(3.1 / c * 140e3 - 1120.0);
  ASSERT_LT(begins + 60, 245U);
  EXPECT_GT(power(wire_of(samples, 0).subspan(begins, 80)), 1000.0);
  EXPECT_EQ(power(wire_of(samples, 0).first(begins)), 0.0);
}

TEST(GarmentSignal, AMovingBoardHearsAnotherPitch) {
  // Towards the source at 10 m/s: the pulse goes by faster by v / c.
  const Range range({board(1.0), board(1.0, 0.0, -10.0)});
  GarmentSignal signal(range, 1, clean());
  const auto samples = slots(signal, range.garment());
  const auto hz = [&](std::size_t i) {  // by the turn of the phase between two windows
    const auto sound = wire_of(samples, i);
    const auto from = static_cast<std::size_t>(centre(sound)) - 24;
    const auto phase = [&](std::size_t at) {
      std::complex<double> sum;
      for (std::size_t k = 0; k < 21; ++k) {  // six cycles
        const double turn = 2.0 * M_PI * 40e3 / 140e3 * static_cast<double>(at + k);
        sum += static_cast<double>(sound[at + k]) * std::polar(1.0, -turn);
      }
      return std::arg(sum);
    };
    return 40e3 +
           std::remainder(phase(from + 28) - phase(from), 2.0 * M_PI) / (2.0 * M_PI) * 140e3 / 28.0;
  };
  EXPECT_NEAR(hz(1) / hz(0) - 1.0, 10.0 / speed_of_sound(20.0), 0.006);
}

TEST(GarmentSignal, IsTheSameForASeedAndGoesThroughTheStream) {
  const Motion motion =
      read_canonical(kSource / "reference_motions/squat/motion.bvh", kSource / "joint_maps");
  const WornGarment worn(motion, practical(), WornErrors{}, 1);
  GarmentSignal a(worn, 7), b(worn, 7), c(worn, 8);
  const auto slot = slots(a, worn.garment(), 3);
  EXPECT_EQ(slot, slots(b, worn.garment(), 3));
  EXPECT_NE(slot, slots(c, worn.garment(), 3));
  std::vector<std::uint8_t> bytes;
  wire::append_slot(a.header(), 0, slot, bytes);
  wire::GarmentStreamReader reader;
  bool same = false;
  reader.feed(bytes, [&](const wire::GarmentSlot& read) { same = read.samples == slot; });
  EXPECT_TRUE(same);
  EXPECT_EQ(reader.header(), a.header());
}

TEST(GarmentSignal, FaultsAreWhereTheyAreSaidToBe) {
  const Range range({board(0.4), board(0.5), board(0.6)});
  SignalOptions options;
  options.gain_spread = 0.0;
  const auto made = [&](const GarmentFaults& faults, int count) {
    options.faults = faults;
    GarmentSignal signal(range, 1, options);
    return slots(signal, range.garment(), count);
  };
  const auto plain = made({}, 5);
  GarmentFaults faults;
  faults.silent = {{1, 0.03, 0.05}};
  const auto silent = made(faults, 5);
  EXPECT_EQ(power(wire_of(silent, 1)), 0.0);
  EXPECT_GT(power(wire_of(silent, 0)), 0.5 * power(wire_of(plain, 0)));
  EXPECT_GT(power(wire_of(made(faults, 8), 1)), 0.5 * power(wire_of(plain, 1)));

  faults = {};
  faults.blocked = {{0, 0.0, 1.0}};
  EXPECT_LT(power(wire_of(made(faults, 1), 0)), 0.5 * power(wire_of(made({}, 1), 0)));

  faults = {};
  faults.bit_errors = {{2, 0.0, 1.0}};
  options.loudness = 0.0;
  EXPECT_GT(power(wire_of(made(faults, 5), 2)), 3.0 * power(wire_of(made({}, 5), 2)));
  options.loudness = SignalOptions{}.loudness;

  faults = {};
  faults.gain = {{0, 0.0, 1.0}};
  const auto loud = made(faults, 1);
  EXPECT_GT(std::count(loud.begin(), loud.begin() + 1120, 32767), 20);

  faults = {};
  faults.swapped = {{0, 2}};
  const auto swapped = made(faults, 1);
  EXPECT_GT(centre(wire_of(swapped, 0)), centre(wire_of(made({}, 1), 0)) + 20.0);
}

TEST(GarmentSignal, AWrongTemperatureScalesWhatIsMeasured) {
  const Range range({board(0.4), board(1.4)});
  SignalOptions options = clean();
  options.faults.temperature_error = 10.0;
  GarmentSignal signal(range, 1, options);
  EXPECT_EQ(signal.header().temperature, 20.0);
  const auto samples = slots(signal, range.garment());
  EXPECT_NEAR(centre(wire_of(samples, 1)) - centre(wire_of(samples, 0)),
              1.0 / speed_of_sound(30.0) * 140e3, 0.3);
}

TEST(SimulatedMeasurements, AreTheSceneWithinTheirErrors) {
  const Range range({board(0.4), board(0.8, 0.3)});
  SimulatedMeasurements measured(range, 1);
  server::Measurement m;
  std::int64_t last_sample = -1;
  int samples = 0, pulses = 0;
  while (measured.next(m) == server::Next::kPose && m.stamp_ns < 2'000'000'000) {
    if (m.kind == server::MeasurementKind::kInertial) {
      EXPECT_GT(m.stamp_ns, last_sample);
      last_sample = m.stamp_ns;
      EXPECT_LT((m.boards[1].accel - Eigen::Vector3d(0, 0, kStandardGravity)).norm(), 1e-9);
      EXPECT_TRUE(m.boards[1].gyro_valid && m.boards[1].accel_valid);
      ++samples;
    } else {
      EXPECT_NEAR(m.distances[0].distance, 0.4, 1e-9);
      EXPECT_NEAR(m.distances[1].distance, std::hypot(0.8, 0.3), 1e-9);
      EXPECT_EQ(m.distances[0].confidence, 1.0);
      EXPECT_LE(m.stamp_ns + 8'000'000, last_sample + 8'000'000);
      ++pulses;
    }
  }
  EXPECT_NEAR(samples, 280, 1);
  EXPECT_NEAR(pulses, 250, 2);
}

TEST(SimulatedMeasurements, TheCodecsErrorIsCarriedAndItsNoiseIsTheStepsShare) {
  const Range range({board(0.4)});
  MeasurementOptions options;
  options.codec = true;
  SimulatedMeasurements measured(range, 1, options);
  server::Measurement m;
  double sum = 0.0, count = 0.0;
  const double step = 2.0 * range.garment().boards[0].accel_range / 64.0;
  while (measured.next(m) == server::Next::kPose) {
    if (m.kind != server::MeasurementKind::kInertial) continue;
    sum += m.boards[0].accel.z() - kStandardGravity;
    count += 1.0;
    EXPECT_LE(std::abs(m.boards[0].accel.z() - kStandardGravity), step);
  }
  EXPECT_LT(std::abs(sum), 2.0 * step + count * 0.5 * step / 64.0);  // 12-bit rounding stays
}

TEST(SimulatedMeasurements, ComeAgainAfterARewind) {
  const Range range({board(0.4), board(0.0, 0.9)});
  SimulatedMeasurements measured(range, 1);
  const auto play = [&] {
    std::vector<double> all;
    server::Measurement m;
    while (measured.next(m) == server::Next::kPose && all.size() < 500) {
      for (const auto& distance : m.distances) all.push_back(distance.distance);
    }
    return all;
  };
  const auto first = play();
  ASSERT_TRUE(measured.rewind());
  EXPECT_EQ(first, play());
}

}  // namespace
}  // namespace secondskin::sim
