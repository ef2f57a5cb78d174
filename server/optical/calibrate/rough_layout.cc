#include "server/optical/calibrate/rough_layout.h"

#include <Eigen/Geometry>
#include <cmath>

namespace secondskin::server {

ProjectorRig RoughLayout::rig(const NominalOptics& optics) const {
  ProjectorRig rig;
  for (const RoughPlace& place : places) {
    const Eigen::Vector3d z = (place.looks_at_W - place.p_W).normalized();
    const Eigen::Vector3d right = z.cross(Eigen::Vector3d::UnitZ()).normalized();
    const Eigen::Vector3d up = right.cross(z);
    const Eigen::Vector3d x = std::cos(place.rising) * right + std::sin(place.rising) * up;
    Projector projector;
    projector.P.leftCols<3>() << (optics.focal * x + optics.middle * z).transpose(), z.transpose();
    projector.P.col(3) = -projector.P.leftCols<3>() * place.p_W;
    projector.P /= projector.P(1, 3);
    rig.projectors.emplace_back(projector);
  }
  return rig;
}

}  // namespace secondskin::server
