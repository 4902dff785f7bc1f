_cellward_completion() {
    local IFS=$'
'
    COMPREPLY=( $( env COMP_WORDS="${COMP_WORDS[*]}" \
                   COMP_CWORD=$COMP_CWORD \
                   _CELLWARD_COMPLETE=complete_bash $1 ) )
    return 0
}

complete -o default -F _cellward_completion cellward
