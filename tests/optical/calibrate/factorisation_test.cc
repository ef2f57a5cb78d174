#include "server/optical/calibrate/factorisation.h"

#include <gtest/gtest.h>

#include <random>

#include "tests/optical/calibrate/synthetic.h"

namespace secondskin::server {
namespace {

struct Scene {
  std::vector<Eigen::Vector3d> places;
  std::vector<std::vector<Sighting>> sightings;
};

Scene scene(const std::vector<Projector>& rig, double noise, std::size_t n, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Scene out;
  while (out.places.size() < n) {
    const Eigen::Vector3d p(0.8 * uniform(random), 0.8 * uniform(random),
                            0.95 + 0.8 * uniform(random));
    std::vector<Sighting> sightings;
    for (std::size_t i = 0; i < rig.size(); ++i) {
      const double v = rig[i].value(p);
      if (v > 1.0 && v < 254.0) sightings.push_back({i, v + noise * normal(random)});
    }
    if (sightings.size() < 5) continue;
    out.places.push_back(p);
    out.sightings.push_back(sightings);
  }
  return out;
}

// RMS of the points after the best similarity, mirrored or not.
double shape_error(const Scene& scene, const Reconstruction& found) {
  Eigen::Matrix3Xd A(3, static_cast<Eigen::Index>(scene.places.size())), B(3, A.cols());
  for (std::size_t k = 0; k < scene.places.size(); ++k) {
    A.col(static_cast<Eigen::Index>(k)) = found.points[k].value();
    B.col(static_cast<Eigen::Index>(k)) = scene.places[k];
  }
  double best = std::numeric_limits<double>::infinity();
  for (int image = 0; image < 2; ++image, A.row(0) *= -1.0) {
    const Eigen::Matrix4d T = Eigen::umeyama(A, B, true);
    best = std::min(
        best, std::sqrt((((T.topLeftCorner<3, 3>() * A).colwise() + T.topRightCorner<3, 1>()) - B)
                            .colwise()
                            .squaredNorm()
                            .mean()));
  }
  return best;
}

TEST(Factorisation, FindsPlacesFromValuesAlone) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    // The optics differ by 2 % and 2 counts from the design that is assumed.
    const auto rig = test::make_rig(16, seed);
    const Scene s = scene(rig, 0.3, 250, seed);
    const auto found = factorise(s.sightings, rig.size(), {}, nullptr, seed);
    ASSERT_TRUE(found);
    EXPECT_LT(found->residual, 0.3);
    EXPECT_LT(shape_error(s, *found), 0.06) << seed;
  }
}

TEST(Factorisation, LeavesOutAProjectorThatSeesLittle) {
  const auto rig = test::make_rig();
  Scene s = scene(rig, 0.3, 250, 1);
  std::size_t kept = 0;
  for (auto& sightings : s.sightings) {
    std::erase_if(sightings, [&](const Sighting& x) { return x.projector == 9 && kept++ >= 10; });
  }
  const auto found = factorise(s.sightings, rig.size(), {}, nullptr, 1);
  ASSERT_TRUE(found);
  EXPECT_FALSE(found->rig.projectors[9]);
  EXPECT_TRUE(found->rig.projectors[8]);
}

TEST(Factorisation, GivesTheSameForTheSameSeed) {
  const auto rig = test::make_rig();
  const Scene s = scene(rig, 0.3, 150, 1);
  const auto a = factorise(s.sightings, rig.size(), {}, nullptr, 5);
  const auto b = factorise(s.sightings, rig.size(), {}, nullptr, 5);
  ASSERT_TRUE(a && b);
  for (std::size_t i = 0; i < rig.size(); ++i) {
    EXPECT_EQ(a->rig.projectors[i]->P, b->rig.projectors[i]->P);
  }
}

TEST(Factorisation, GivesNothingForTooLittle) {
  const auto rig = test::make_rig(4);
  std::vector<std::vector<Sighting>> few(100);
  EXPECT_FALSE(factorise({}, 16, {}, nullptr, 1));
  EXPECT_FALSE(factorise(few, 16, {}, nullptr, 1));
}

}  // namespace
}  // namespace secondskin::server
