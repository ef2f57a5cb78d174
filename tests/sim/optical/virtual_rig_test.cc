#include "sim/optical/virtual_rig.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "scenes.h"
#include "wire/photo_tag.h"

namespace secondskin::sim {
namespace {

constexpr double kFoot = 0.3048;
constexpr double kPi = std::numbers::pi;

using Values = std::vector<std::uint8_t>;

// What one detector that does not move and looks at the projector receives from it.
std::uint8_t receive(const VirtualProjector& projector, const Eigen::Vector3d& p_W,
                     const OpticalNoise& noise, std::uint64_t seed = 1) {
  FakeScene scene(1, [&](std::size_t, double) {
    return DetectorState{p_W, (projector.X_WJ.translation() - p_W).normalized()};
  });
  VirtualRig rig({projector}, scene, noise, seed);
  Values values(1);
  rig.cycle(0.0, values);
  return values[0];
}

// A point with a coordinate on the mask of projector_on_x(), 0 to 256, at a distance before it.
Eigen::Vector3d point_at(double coordinate, double distance, double z = 0.0) {
  return {kProjectorX + distance, -(coordinate / 128.0 - 1.0) * distance * std::tan(kPi / 12.0), z};
}

TEST(SecondSkinRig, IsTheOneOf2_3) {
  const auto rig = second_skin_rig();
  ASSERT_EQ(rig.size(), 16U);
  for (std::size_t i = 0; i < rig.size(); i += 2) {
    const auto &first = rig[i], &second = rig[i + 1];
    // A pair is one unit on a tripod, its projectors perpendicular to each other.
    EXPECT_TRUE(first.X_WJ.translation().isApprox(second.X_WJ.translation()));
    EXPECT_NEAR(first.X_WJ.linear().col(0).dot(second.X_WJ.linear().col(0)), 0.0, 1e-12);
    EXPECT_TRUE(first.X_WJ.linear().col(2).isApprox(second.X_WJ.linear().col(2)));
    // On a circle of 22 feet, facing in towards the centre.
    const Eigen::Vector3d p = first.X_WJ.translation();
    EXPECT_NEAR(2.0 * p.head<2>().norm(), 22.0 * kFoot, 1e-9);
    EXPECT_TRUE(first.X_WJ.linear().col(2).head<2>().isApprox(-p.head<2>().normalized(), 1e-12));
    EXPECT_NEAR(first.X_WJ.linear().determinant(), 1.0, 1e-12);
    // The pairs stand evenly.
    const Eigen::Vector3d next = rig[(i + 2) % 16].X_WJ.translation();
    EXPECT_NEAR((next - p).norm(), 22.0 * kFoot * std::sin(kPi / 8.0), 1e-9);
  }
  for (const VirtualProjector& projector : rig) {
    EXPECT_DOUBLE_EQ(projector.field, kPi / 6.0);
    EXPECT_DOUBLE_EQ(projector.farthest, 35.0 * kFoot);
  }
}

TEST(SecondSkinRig, CodesToTheLeftAndUp) {
  const auto rig = second_skin_rig();
  const Eigen::Vector3d middle(0.0, 0.0, 0.85);
  for (std::size_t i = 0; i < rig.size(); i += 2) {
    const Eigen::Vector3d facing = rig[i].X_WJ.translation() - middle;
    const Eigen::Vector3d left = Eigen::Vector3d::UnitZ().cross(facing).normalized();
    EXPECT_GT(*rig[i].coordinate(middle + 0.1 * left), *rig[i].coordinate(middle) + 10.0);
    EXPECT_GT(*rig[i + 1].coordinate(middle + Eigen::Vector3d(0, 0, 0.1)), 138.0);
    EXPECT_NEAR(*rig[i].coordinate(middle), 128.0, 1e-9);
    EXPECT_NEAR(*rig[i + 1].coordinate(middle), 128.0, 1e-9);
  }
}

TEST(SecondSkinRig, CoversTheCylinderOf2_3) {
  // 6 feet high, 6.5 feet across: a point inside is lit by at least half of the projectors; where
  // a body stands, by all but the nearest.
  const auto rig = second_skin_rig();
  const auto lit = [&](const Eigen::Vector3d& p) {
    return std::count_if(rig.begin(), rig.end(), [&](const auto& projector) {
      return projector.coordinate(p).has_value();
    });
  };
  int points = 0, by_half = 0;
  for (double x = -0.95; x <= 0.95; x += 0.1) {
    for (double y = -0.95; y <= 0.95; y += 0.1) {
      if (std::hypot(x, y) > 3.25 * kFoot) continue;
      for (double z = 0.05; z < 6.0 * kFoot; z += 0.1) {
        ++points;
        by_half += lit({x, y, z}) >= 8 ? 1 : 0;
        if (std::hypot(x, y) < 0.3 && z < 1.6) {
          EXPECT_GE(lit({x, y, z}), 10) << x << " " << y << " " << z;
        }
      }
    }
  }
  EXPECT_GT(by_half, 0.92 * points);
}

TEST(VirtualProjector, CoordinateIsLinearInTheTangent) {
  const VirtualProjector projector = projector_on_x();
  const double edge = std::tan(15.0 * kPi / 180.0);
  for (const double u : {-1.0, -0.5, 0.0, 0.25, 1.0}) {
    const auto coordinate =
        projector.coordinate({kProjectorX + 4.0, -0.999999 * u * 4.0 * edge, 0.3});
    ASSERT_TRUE(coordinate);
    EXPECT_NEAR(*coordinate, 128.0 * (1.0 + u), 1e-3);
  }
}

TEST(VirtualProjector, LightsNothingOutsideItsFieldAndRange) {
  VirtualProjector projector = projector_on_x();
  projector.nearest = 1.0;
  EXPECT_TRUE(projector.coordinate({kProjectorX + 4.0, 0.0, 1.07}));
  EXPECT_FALSE(projector.coordinate({kProjectorX + 4.0, 0.0, 1.08}));
  EXPECT_FALSE(projector.coordinate({kProjectorX + 4.0, -1.08, 0.0}));
  EXPECT_FALSE(projector.coordinate({kProjectorX - 4.0, 0.0, 0.0}));
  EXPECT_FALSE(projector.coordinate({kProjectorX + 0.9, 0.0, 0.0}));
  EXPECT_TRUE(projector.coordinate({kProjectorX + 35.0 * kFoot - 1e-6, 0.0, 0.0}));
  EXPECT_FALSE(projector.coordinate({kProjectorX + 35.0 * kFoot + 1e-6, 0.0, 0.0}));
  EXPECT_FALSE(projector.coordinate({NAN, 0.0, 0.0}));
}

TEST(VirtualProjector, MatrixIsTheCoordinateWithoutHalfACount) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> place(-1.0, 1.0);
  int seen = 0;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d p(place(random), place(random), 0.9 + 0.9 * place(random));
    for (const VirtualProjector& projector : second_skin_rig()) {
      const auto P = projector.matrix();
      EXPECT_DOUBLE_EQ(P(1, 3), 1.0);
      const auto coordinate = projector.coordinate(p);
      if (!coordinate) continue;
      const Eigen::Vector2d hv = P * p.homogeneous();
      EXPECT_NEAR(hv[0] / hv[1], *coordinate - 0.5, 1e-9);
      ++seen;
    }
  }
  EXPECT_GT(seen, 10'000);
}

TEST(VirtualRig, ADetectorThatStandsReceivesTheStripeThatItStandsIn) {
  const VirtualProjector projector = projector_on_x();
  const auto P = projector.matrix();
  for (int value = 1; value < 255; ++value) {
    for (const double inside : {0.02, 0.5, 0.98}) {
      const Eigen::Vector3d p = point_at(value + inside, 3.0 + 0.01 * value, 0.2);
      ASSERT_EQ(receive(projector, p, no_noise()), value);
      const Eigen::Vector2d hv = P * p.homogeneous();
      ASSERT_LE(std::abs(hv[0] / hv[1] - value), 0.5);
    }
  }
}

TEST(VirtualRig, SendsNeither0Nor255) {
  EXPECT_EQ(receive(projector_on_x(), point_at(0.5, 3.0), no_noise()), 0);
  EXPECT_EQ(receive(projector_on_x(), point_at(255.5, 3.0), no_noise()), 0);
  EXPECT_EQ(receive(projector_on_x(), point_at(254.5, 3.0), no_noise()), 254);
}

TEST(VirtualRig, ValuesRiseAcrossTheField) {
  int last = 0;
  for (double coordinate = 1.0; coordinate < 255.0; coordinate += 0.1) {
    const int value = receive(projector_on_x(), point_at(coordinate, 5.0), no_noise());
    ASSERT_GE(value, last);
    ASSERT_LE(value, last + 1);
    last = value;
  }
  EXPECT_EQ(last, 254);
}

TEST(VirtualRig, AMovingDetectorsCodeIsOfSeveralPlaces) {
  // So fast that it crosses a stripe between two bits; each bit from where it is in the middle of
  // that bit's light.
  const VirtualProjector projector = projector_on_x();
  const double distance = 3.0;
  int mixed = 0;
  for (double start = 20.0; start < 200.0; start += 0.7) {
    const double counts_a_second = 1.2 / 66e-6;
    const auto place = [&](double time) {
      return point_at(start + counts_a_second * time, distance);
    };
    FakeScene scene(1, [&](std::size_t, double time) {
      return DetectorState{place(time), -Eigen::Vector3d::UnitX()};
    });
    VirtualRig rig({projector}, scene, no_noise(), 1);
    Values values(1);
    rig.cycle(0.0, values);

    std::uint8_t gray = 0;
    std::set<int> places;
    for (int bit = 0; bit < wire::kBits; ++bit) {
      const double time =
          1e-9 * static_cast<double>(wire::bit_start_ns(0, bit) + wire::kBitOnNs / 2);
      const auto stripe = static_cast<std::uint8_t>(*projector.coordinate(place(time)));
      places.insert(stripe);
      const unsigned mask = 0x80U >> bit;
      gray = static_cast<std::uint8_t>(gray | (wire::to_gray(stripe) & mask));
    }
    const std::uint8_t expected = wire::from_gray(gray);
    ASSERT_EQ(values[0], expected == 255 ? 0 : expected) << start;
    mixed += places.contains(expected) ? 0 : 1;
  }
  EXPECT_GT(mixed, 10);  // some are values of no place at all
}

TEST(VirtualRig, EachProjectorSeesTheDetectorAtItsOwnTime) {
  // Sixteen projectors in one place: a detector that moves at 2 m/s shows each another place.
  FakeScene scene(1, [&](std::size_t, double time) {
    return DetectorState{{1.0, 0.5 - 2.0 * time, 0.0}, -Eigen::Vector3d::UnitX()};
  });
  VirtualRig rig(std::vector<VirtualProjector>(16, projector_on_x()), scene, no_noise(), 1);
  Values values(16);
  const double start = 0.1;
  rig.cycle(start, values);
  const auto P = projector_on_x().matrix();
  for (std::size_t i = 0; i < 16; ++i) {
    const double time = start + 1e-9 * static_cast<double>(wire::value_time_ns(i));
    const Eigen::Vector2d hv = P * Eigen::Vector4d(1.0, 0.5 - 2.0 * time, 0.0, 1.0);
    EXPECT_NEAR(values[i], hv[0] / hv[1], 0.7) << i;
  }
  EXPECT_GE(values[15] - values[0], 4);
}

TEST(VirtualRig, NoiseIsUnbiasedAndOfItsSize) {
  OpticalNoise noise = no_noise();
  noise.count_sigma = 0.5;
  const auto P = projector_on_x().matrix();
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> across(10.0, 245.0);
  double sum = 0.0, squares = 0.0;
  constexpr int kDraws = 20'000;
  for (int i = 0; i < kDraws; ++i) {
    const Eigen::Vector3d p = point_at(across(random), 3.3);
    const Eigen::Vector2d hv = P * p.homogeneous();
    const double error = receive(projector_on_x(), p, noise, random()) - hv[0] / hv[1];
    sum += error;
    squares += error * error;
  }
  EXPECT_NEAR(sum / kDraws, 0.0, 0.02);
  // Rounding and edge noise together; a bit's own edges lie two counts apart at least, so a little
  // of the noise shows twice.
  const double expected = std::sqrt(0.25 + 1.0 / 12.0);
  EXPECT_NEAR(std::sqrt(squares / kDraws), expected, 0.15 * expected);
}

TEST(VirtualRig, ATiltedMaskMakesJumpyValues) {
  const auto largest_jump = [](double tilt) {
    VirtualProjector projector = projector_on_x();
    projector.mask_tilt = tilt;
    int largest = 0, last = -1;
    for (double coordinate = 20.0; coordinate < 236.0; coordinate += 0.05) {
      const int value = receive(projector, point_at(coordinate, 3.0), no_noise(),
                                static_cast<std::uint64_t>(coordinate * 100.0));
      if (last >= 0) largest = std::max(largest, std::abs(value - last));
      last = value;
    }
    return largest;
  };
  EXPECT_EQ(largest_jump(0.0), 1);
  EXPECT_GE(largest_jump(4.0), 5);
  EXPECT_LE(largest_jump(4.0), 20);
}

// Values of a detector in the middle of the field that looks past its projector by an angle.
std::vector<int> values_at_angle(double angle_deg, const OpticalNoise& noise, int draws) {
  const Eigen::Vector3d p = point_at(85.5, 3.0);
  const Eigen::Vector3d to_projector = (projector_on_x().X_WJ.translation() - p).normalized();
  const Eigen::Vector3d n =
      Eigen::AngleAxisd(angle_deg * kPi / 180.0, Eigen::Vector3d::UnitZ()) * to_projector;
  // Another projector, in its clear view, gives it the sync bit.
  VirtualProjector other = projector_on_x();
  other.X_WJ.linear() = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), -n).matrix();
  other.X_WJ.translation() = p + 3.0 * n;
  FakeScene scene(1, [&](std::size_t, double) { return DetectorState{p, n}; });
  VirtualRig rig({projector_on_x(), other}, scene, noise, 1);
  std::vector<int> values;
  Values cycle(2);
  for (int i = 0; i < draws; ++i) {
    rig.cycle(0.0, cycle);
    values.push_back(cycle[0]);
  }
  return values;
}

TEST(VirtualRig, LosesBitsAtTheEdgeOfADetectorsView) {
  const auto share = [](const std::vector<int>& values, auto condition) {
    return static_cast<double>(std::count_if(values.begin(), values.end(), condition)) /
           static_cast<double>(values.size());
  };
  const auto right = [](int v) { return v == 85; };
  const auto wild = [](int v) { return v != 85 && v != 0; };
  EXPECT_EQ(share(values_at_angle(0.0, no_noise(), 100), right), 1.0);
  EXPECT_EQ(share(values_at_angle(61.9, no_noise(), 100), right), 1.0);
  EXPECT_EQ(share(values_at_angle(70.1, no_noise(), 100), [](int v) { return v == 0; }), 1.0);
  // A third into the zone ten of fifteen pulses are as likely as not.
  EXPECT_GT(share(values_at_angle(64.7, no_noise(), 1000), wild), 0.5);
  EXPECT_GT(share(values_at_angle(62.5, no_noise(), 1000), right), 0.9);
  EXPECT_GT(share(values_at_angle(69.5, no_noise(), 1000), [](int v) { return v == 0; }), 0.9);
}

TEST(VirtualRig, ADetectorWithoutADirectionSeesEverywhere) {
  FakeScene scene(1, [](std::size_t, double) {
    return DetectorState{{0.0, 0.0, 0.85}, Eigen::Vector3d::Zero()};
  });
  VirtualRig rig(second_skin_rig(), scene, no_noise(), 1);
  Values values(16);
  rig.cycle(0.0, values);
  for (const int value : values) EXPECT_NEAR(value, 128, 1);
}

class RigInTheMiddle : public testing::Test {
 protected:
  static constexpr std::size_t kDetectors = 40;
  // Detectors that look around the circle.
  FakeScene scene_{kDetectors, [](std::size_t i, double) {
                     const double a = 2.0 * kPi * static_cast<double>(i) / kDetectors;
                     return DetectorState{{0.05, 0.02, 0.9}, {std::cos(a), std::sin(a), 0.0}};
                   }};
  Values cycle(VirtualRig& rig) {
    Values values(kDetectors * 16);
    rig.cycle(0.0, values);
    return values;
  }
};

TEST_F(RigInTheMiddle, WithoutASyncBitADetectorSendsZerosOnly) {
  OpticalNoise noise = no_noise();
  noise.dropped_sync = 0.3;
  VirtualRig rig(second_skin_rig(), scene_, noise, 1);
  int dropped = 0;
  constexpr int kCycles = 200;
  for (int i = 0; i < kCycles; ++i) {
    const Values values = cycle(rig);
    for (std::size_t d = 0; d < kDetectors; ++d) {
      const auto row = std::span(values).subspan(d * 16, 16);
      const bool empty = std::all_of(row.begin(), row.end(), [](int v) { return v == 0; });
      EXPECT_EQ(empty, rig.synced()[d] == 0);
      dropped += empty ? 1 : 0;
    }
  }
  EXPECT_NEAR(dropped / static_cast<double>(kDetectors * kCycles), 0.3, 0.02);
}

TEST_F(RigInTheMiddle, ADarkProjectorIsMissingAloneAndComesBack) {
  OpticalNoise noise = no_noise();
  noise.grazing = 0.0;
  VirtualRig rig(second_skin_rig(), scene_, noise, 1);
  const Values lit = cycle(rig);
  rig.projectors()[3].dark = true;
  const Values dark = cycle(rig);
  for (std::size_t i = 0; i < lit.size(); ++i) {
    if (i % 16 == 3) {
      EXPECT_EQ(dark[i], 0);
    } else {
      EXPECT_EQ(dark[i], lit[i]);
    }
  }
  rig.projectors()[3].dark = false;
  EXPECT_EQ(cycle(rig), lit);
}

TEST_F(RigInTheMiddle, InTheDarkNobodyIsInStep) {
  VirtualRig rig(second_skin_rig(), scene_, no_noise(), 1);
  for (VirtualProjector& projector : rig.projectors()) projector.dark = true;
  const Values values = cycle(rig);
  EXPECT_EQ(std::count(values.begin(), values.end(), 0), static_cast<int>(values.size()));
  EXPECT_EQ(std::count(rig.synced().begin(), rig.synced().end(), 0), static_cast<int>(kDetectors));
}

TEST_F(RigInTheMiddle, ReplacesTheAskedShareByWildValues) {
  OpticalNoise noise = no_noise();
  noise.grazing = 0.0;
  VirtualRig clean(second_skin_rig(), scene_, noise, 1);
  const Values truth = cycle(clean);
  noise.wild_share = 0.02;
  VirtualRig rig(second_skin_rig(), scene_, noise, 1);
  int seen = 0, wild = 0;
  for (int i = 0; i < 300; ++i) {
    const Values values = cycle(rig);
    for (std::size_t k = 0; k < values.size(); ++k) {
      if (truth[k] == 0) continue;
      ++seen;
      wild += values[k] != truth[k] ? 1 : 0;
    }
  }
  EXPECT_NEAR(static_cast<double>(wild) / seen, 0.02, 0.002);
}

TEST_F(RigInTheMiddle, IsTheSameForTheSameSeed) {
  OpticalNoise noise;
  noise.wild_share = 0.1;
  const auto run = [&](std::uint64_t seed) {
    VirtualRig rig(second_skin_rig(), scene_, noise, seed);
    cycle(rig);
    return cycle(rig);
  };
  EXPECT_EQ(run(5), run(5));
  EXPECT_NE(run(5), run(6));
}

TEST(VirtualRig, RefusesNoProjectors) {
  FakeScene scene(1, [](std::size_t, double) { return DetectorState{}; });
  EXPECT_THROW(VirtualRig({}, scene, {}, 1), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::sim
