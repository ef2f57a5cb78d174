#pragma once

#include <secondskin_msgs.h>  // generated from idl/secondskin_msgs.idl

/// The topics' types as services see them at their edges.
namespace secondskin::bus {
namespace msg = ::secondskin_msgs::msg;
}  // namespace secondskin::bus
