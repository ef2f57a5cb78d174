#include "server/wearable/estimate/body_layout.h"

#include <algorithm>
#include <stdexcept>

#include "motion/anatomy.h"

namespace secondskin::server {

BodyLayout::BodyLayout(const Skeleton& canonical, const Garment& garment)
    : boards(static_cast<int>(garment.boards.size())) {
  if (!is_canonical(canonical)) {
    throw std::invalid_argument("wearable filter: the skeleton is not the canonical one");
  }
  path.resize(kJointCount);
  for (std::size_t i = 0; i < kJointCount; ++i) {
    if (canonical[i].parent) path[i] = path[*canonical[i].parent];
    path[i].push_back(i);
  }
  std::array<bool, kJointCount> leads_to_board{};
  for (const SensorBoard& board : garment.boards) {
    sensed[index(board.segment)] = true;
    for (const std::size_t i : path[index(board.segment)]) leads_to_board[i] = true;
  }
  leads_to_board[0] = true;

  // A joint continues its parent's chain if the parent's segment has no board, and the way to one
  // does not fork there.
  std::array<int, kJointCount> ways{};
  for (std::size_t i = 1; i < kJointCount; ++i) {
    if (!leads_to_board[i]) continue;
    ++ways[*canonical[i].parent];
  }
  group_of.fill(kNoGroup);
  group_of[0] = groups++;
  for (std::size_t i = 1; i < kJointCount; ++i) {
    if (!leads_to_board[i]) continue;
    const std::size_t parent = *canonical[i].parent;
    group_of[i] = groups++;
    if (parent != 0 && !sensed[parent] && ways[parent] == 1) {
      for (std::vector<int>& chain : chains) {
        if (chain.back() == group_of[parent]) chain.push_back(group_of[i]);
      }
    } else {
      chains.push_back({group_of[i]});
    }
  }
}

}  // namespace secondskin::server
