#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "motion/kinematics.h"
#include "motion/retarget.h"
#include "server/wearable/estimate/body_filter.h"
#include "server/wearable/signal/ultrasound.h"
#include "sim/wearable/garment_signal.h"
#include "sim/wearable/simulated_measurements.h"
#include "sim/wearable/worn_garment.h"

// Two people in one room, each with sources of an own frequency, so that the boards of one can tell
// how far the other is (Practical Motion Capture, section 6).
namespace secondskin::server {
namespace {

const std::filesystem::path kSource(SECONDSKIN_SOURCE_DIR);
constexpr double kCarrier = 40e3, kOtherCarrier = 32e3;
constexpr double kTemperature = 20.0;

Garment practical() { return Garment::load(kSource / "garments/practical.toml"); }

// One board, and one source of the carrier facing it from so far away.
class Facing final : public sim::GarmentScene {
 public:
  Facing(double distance, double carrier_hz) : distance_(distance) {
    garment_ = practical();
    garment_.boards.resize(1);
    garment_.sources.resize(1);
    garment_.carrier_hz = carrier_hz;
  }
  const Garment& garment() const noexcept override { return garment_; }
  const sim::WornErrors& errors() const noexcept override { return errors_; }
  double duration() const noexcept override { return 10.0; }
  void boards_at(double, std::span<sim::BoardTruth> boards) const noexcept override {
    boards[0] = {};
    boards[0].X_WS.translation().x() = distance_;
  }
  void at(double time, sim::GarmentInstant& out) const override {
    out.boards.resize(1);
    boards_at(time, out.boards);
    out.sources.assign(1, Eigen::Isometry3d(Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitY())));
    out.source_v.assign(1, Eigen::Vector3d::Zero());
  }
  std::span<const sim::Reflector> reflectors() const noexcept override { return {}; }

 private:
  double distance_;
  Garment garment_;
  sim::WornErrors errors_ = sim::WornErrors::none();
};

// The slots that a board hears of both sources at once.
std::vector<std::vector<std::int16_t>> heard(double own, double other, int slots) {
  const Facing own_scene(own, kCarrier), other_scene(other, kOtherCarrier);
  sim::SignalOptions options;
  options.digital = options.start_spread = options.transducer_spread = options.gain_spread = 0.0;
  sim::GarmentSignal own_signal(own_scene, 1, options);
  options.noise = 0.0;
  sim::GarmentSignal other_signal(other_scene, 2, options);
  std::vector<std::vector<std::int16_t>> result;
  std::vector<std::int16_t> a(own_scene.garment().slot_samples), b(a.size());
  for (int i = 0; i < slots; ++i) {
    own_signal.next(a);
    other_signal.next(b);
    for (std::size_t k = 0; k < a.size(); ++k) a[k] = static_cast<std::int16_t>(a[k] + b[k]);
    result.push_back(a);
  }
  return result;
}

double metres(const Arrival& arrival) {
  return (arrival.inflection - SourceCalibration{}.offset) / practical().sample_rate_hz *
         speed_of_sound(kTemperature);
}

TEST(SecondWearer, EachFrequencyIsHeardByItself) {
  for (const auto& [own, other] : {std::pair{0.8, 1.5}, {1.5, 1.0}, {0.6, 2.2}}) {
    ArrivalFinder finds_own(practical().sample_rate_hz, kCarrier, practical().slot_samples);
    ArrivalFinder finds_other(practical().sample_rate_hz, kOtherCarrier, practical().slot_samples);
    std::size_t owns = 0, others = 0;
    for (const auto& slot : heard(own, other, 40)) {
      if (const auto arrival = finds_own.find(slot)) {
        EXPECT_NEAR(metres(*arrival), own, 0.02) << own << " and " << other;
        ++owns;
      }
      if (const auto arrival = finds_other.find(slot)) {
        EXPECT_NEAR(metres(*arrival), other, 0.02) << own << " and " << other;
        ++others;
      }
    }
    EXPECT_GE(owns, 38u);  // the first slots tell what the noise is
    EXPECT_GE(others, 38u);
  }
}

// A walker whose root nobody gives: inertia alone loses it, distances to somebody who stands by
// keep it. Boards without errors, sound with the paper's (5.2).
double root_error(bool with_second_wearer) {
  const Motion walk = read_canonical(kSource / "reference_motions/stepping_punch/motion.bvh",
                                     kSource / "joint_maps");
  const sim::WornGarment walker(walk, practical(), sim::WornErrors::none(), 1);
  Motion still = walk;
  still.poses.assign(2, Pose(kJointCount));
  for (Pose& pose : still.poses) pose.p_WR = walk.poses[0].p_WR + Eigen::Vector3d(1.5, 0.3, 0.0);
  const sim::WornGarment bystander(still, practical(), sim::WornErrors::none(), 2);
  sim::GarmentInstant there;
  bystander.at(0.0, there);

  std::vector<Eigen::Isometry3d> X_BS;
  for (std::size_t b = 0; b < walker.garment().boards.size(); ++b)
    X_BS.push_back(walker.mounted(b));
  BodyFilter filter(walker.assumed_skeleton(), walker.garment(), X_BS, {});
  Pose truth(kJointCount);
  walker.pose_at(0.0, truth);
  filter.start(truth, 0, {});
  sim::SimulatedMeasurements measured(walker, 3, {});
  std::mt19937 random(4);
  std::normal_distribution<double> noise(0.0, 0.0025);
  std::vector<sim::BoardTruth> boards(walker.garment().boards.size());
  double sum = 0.0;
  std::size_t count = 0;
  Measurement m;
  while (measured.next(m) == Next::kPose) {
    filter.process(m);
    const double t = 1e-9 * static_cast<double>(m.stamp_ns);
    if (m.kind != MeasurementKind::kDistances) {
      walker.pose_at(t, truth);
      sum += (filter.pose().p_WR - truth.p_WR).squaredNorm();
      ++count;
    } else if (with_second_wearer) {
      walker.boards_at(t, boards);
      const Eigen::Vector3d p_WU = there.sources[count % there.sources.size()].translation();
      for (std::size_t b = 0; b < boards.size(); b += 6) {
        const double d = (boards[b].X_WS.translation() - p_WU).norm() + noise(random);
        filter.observe_distance(m.stamp_ns, b, p_WU, d, 0.05);
      }
    }
  }
  return std::sqrt(sum / static_cast<double>(count));
}

TEST(SecondWearer, WhoStandsByBoundsTheRootOfTheOther) {
  const double alone = root_error(false), together = root_error(true);
  EXPECT_LT(together, 0.1);
  EXPECT_LT(together, 0.5 * alone);
}

}  // namespace
}  // namespace secondskin::server
