# A session with the steering node, forwards and backwards. The test compares what it prints.
set pagination off
set confirm off
set width 0
set remotetimeout 60
set language c
info registers pc
printf "first %d\n", $pc == ((unsigned *) 0x08000000)[1] - 1

# Flash is read-only, so a plain breakpoint is one of hardware.
break USB_LP_CAN_RX0
continue
monitor time
printf "exception %d\n", $xpsr & 0x1ff
set $met = $sp
stepi
stepi
reverse-stepi
reverse-stepi
printf "back %d\n", $sp == $met
continue
reverse-continue
printf "again %d\n", $sp == $met
delete

# The word of RTT's control block that says how far the log is written.
watch *(unsigned *) ((char *) &_SEGGER_RTT + 36)
monitor until 2.5 s
continue
continue
set $written = *(unsigned *) ((char *) &_SEGGER_RTT + 36)
printf "written %d\n", $written > 0
reverse-continue
printf "before %d\n", *(unsigned *) ((char *) &_SEGGER_RTT + 36) != $written
delete
monitor until 2.5 s
continue
monitor time
monitor nodes
monitor world
monitor bus 2
monitor log 2

# A change is undone by going back behind it.
set *(unsigned *) 0x20002000 = 77
set $r0 = 4711
printf "set %d %d\n", *(unsigned *) 0x20002000, $r0
reverse-stepi
printf "undone %d\n", *(unsigned *) 0x20002000
printf "float %d\n", sizeof($d0)
reverse-continue
monitor until mode:AutonomousReady
continue
monitor time
monitor bus 1
kill
