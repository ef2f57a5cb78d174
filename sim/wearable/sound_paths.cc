#include "sim/wearable/sound_paths.h"

#include <algorithm>
#include <cmath>

#include "sim/wearable/acoustics.h"

namespace secondskin::sim {
namespace {

constexpr double kNearest = 0.02;      // two things are not closer [m]
constexpr double kWeakest = 2e-4;      // amplitudes below are left out
constexpr double kSkin = 0.5;          // of the sound comes back from a clothed limb
constexpr std::size_t kLeastLimb = 7;  // Joint::kLeftShoulder: arms and legs reflect

// A microphone hears a little worse from behind. @param cosine of the angle to the board's z
double microphone(double cosine) noexcept { return 0.8 + 0.2 * cosine; }

struct Ends {
  Eigen::Vector3d p_WU, v_U;
  const BoardTruth& S;
};

// The way from a point that sounds like the source (itself, or its mirror image).
SoundPath straight(const Ends& ends, double detour, double c, Eigen::Vector3d& way) noexcept {
  SoundPath path;
  for (int i = 0; i < 3; ++i) {
    const double t = path.delay;
    way = ends.S.X_WS.translation() + t * ends.S.v + 0.5 * t * t * ends.S.a - ends.p_WU;
    path.delay = (std::max(kNearest, way.norm()) + detour) / c;
  }
  const double length = std::max(kNearest, way.norm());
  path.pace = 1.0 - (ends.S.v - ends.v_U).dot(way) / length / c;
  path.amplitude =
      spread(length + detour) * microphone(-ends.S.X_WS.linear().col(2).dot(way) / length);
  return path;
}

}  // namespace

std::size_t sound_paths(const GarmentInstant& instant, std::span<const Reflector> reflectors,
                        std::size_t source, std::size_t board, double c, double carrier_hz,
                        SoundPaths& out) noexcept {
  const BoardTruth& S = instant.boards[board];
  const Eigen::Vector3d p_WU = instant.sources[source].translation();
  const Eigen::Vector3d p_WS = S.X_WS.translation();
  const Eigen::Vector3d n_W = instant.sources[source].linear().col(2);
  const Eigen::Vector3d& v_U = instant.source_v[source];
  const double wavelength = c / carrier_hz;
  std::size_t count = 0;
  Eigen::Vector3d way;

  const Shadow shadow = acoustic_shadow(p_WU, p_WS, instant.limbs, wavelength);
  out[count] = straight({p_WU, v_U, S}, shadow.detour, c, way);
  out[count++].amplitude *=
      shadow.amplitude * directivity(n_W.dot(way) / std::max(kNearest, way.norm()));

  for (const Reflector& plane : reflectors) {
    if (count == out.size()) break;
    const double height = plane.n_W.dot(p_WU) - plane.offset;
    const double other = plane.n_W.dot(p_WS) - plane.offset;
    if (height <= 0.0 || other <= 0.0) continue;
    const Eigen::Vector3d image = p_WU - 2.0 * height * plane.n_W;
    const Eigen::Vector3d image_v = v_U - 2.0 * plane.n_W.dot(v_U) * plane.n_W;
    SoundPath path = straight({image, image_v, S}, 0.0, c, way);
    const Eigen::Vector3d touch = image + height / (height + other) * (p_WS - image);
    path.amplitude *= plane.amplitude * directivity(n_W.dot((touch - p_WU).normalized()));
    if (path.amplitude < kWeakest) continue;
    path.amplitude *= acoustic_shadow(p_WU, touch, instant.limbs, wavelength).amplitude *
                      acoustic_shadow(touch, p_WS, instant.limbs, wavelength).amplitude;
    if (path.amplitude >= kWeakest) out[count++] = path;
  }

  // A limb scatters from where its skin is nearest to the middle of the way: a round thing of
  // radius r weakens what it reflects by sqrt(r / (r + 2 d1 d2 / (d1 + d2))).
  for (std::size_t i = kLeastLimb; i < instant.limbs.size() && count < out.size(); ++i) {
    const Limb& limb = instant.limbs[i];
    const Eigen::Vector3d middle = 0.5 * (p_WU + p_WS);
    const Eigen::Vector3d axis = limb.p_WE - limb.p_WA;
    const double along =
        std::clamp((middle - limb.p_WA).dot(axis) / std::max(axis.squaredNorm(), 1e-9), 0.0, 1.0);
    const Eigen::Vector3d at = limb.p_WA + along * axis;
    const double away = (middle - at).norm();
    if (away <= limb.radius) continue;
    const Eigen::Vector3d touch = at + limb.radius / away * (middle - at);
    const Eigen::Vector3d from = touch - p_WU, to = p_WS - touch;
    const double d1 = from.norm(), d2 = to.norm();
    // The board's own limb, or so near to the direct way that the shadow has it.
    if (d1 < kNearest || d2 < 0.05 || d1 + d2 < 1.01 * (p_WS - p_WU).norm()) continue;
    SoundPath path;
    path.delay = (d1 + d2) / c;
    path.pace = 1.0 - (S.v.dot(to) / d2 - v_U.dot(from) / d1) / c;
    path.amplitude = kSkin * std::sqrt(limb.radius / (limb.radius + 2.0 * d1 * d2 / (d1 + d2))) *
                     spread(d1 + d2) * directivity(n_W.dot(from) / d1) *
                     microphone(-S.X_WS.linear().col(2).dot(to) / d2);
    if (path.amplitude < kWeakest) continue;
    path.amplitude *=
        acoustic_shadow(p_WU, touch + 0.01 * (touch - at).normalized(), instant.limbs, wavelength)
            .amplitude;
    if (path.amplitude >= kWeakest) out[count++] = path;
  }
  return count;
}

}  // namespace secondskin::sim
