#include "bus/topics.h"

#include <fmt/format.h>

namespace secondskin::bus {

std::string full_topic_name(std::string_view subject, std::string_view name) {
  return fmt::format("rt/secondskin/{}/{}", subject, name);
}

std::string idl_type_name(std::string_view type_name) {
  constexpr std::string_view kRosModule = "dds_::";
  std::string name(type_name);
  name.erase(name.find(kRosModule), kRosModule.size());
  name.pop_back();
  return name;
}

}  // namespace secondskin::bus
