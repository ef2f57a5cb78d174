#include "bus/topics.h"

#include <fmt/format.h>

namespace secondskin::bus {

std::string full_topic_name(std::string_view subject, std::string_view name) {
  return fmt::format("rt/secondskin/{}/{}", subject, name);
}

}  // namespace secondskin::bus
